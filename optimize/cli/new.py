"""``tactilux new``: a commented scene file from flags, or from questions at a terminal."""

from __future__ import annotations

import inspect
import math
import shlex
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, Optional

from typer import Argument, Option

from optimize.cli.options import Json
from optimize.ui.console import counted, note, print_json, reserved_stdout
from render.errors import SceneError

if TYPE_CHECKING:
    from render.scene.new_scene import Answers


NUMBERS = {
    "width": (float, "Of the pad, across, mm."),
    "length": (float, "Of the pad, from base to tip, mm."),
    "thickness": (float, "Of the clear gel, mm."),
    "diffuser": (float, "Thickness of the diffuser on the edges, mm; 0 for none."),
    "left": (int, "Lamps along the left edge."),
    "tip": (int, "Lamps along the tip."),
    "right": (int, "Lamps along the right edge."),
    "base": (int, "Lamps along the base."),
    "distance": (float, "From the camera to the pad, mm."),
    "field_of_view": (float, "Of the camera along the pad, degrees (default: all of it)."),
    "place_lamps": (int, "At most so many lit, which explore places along the edges."),
}
"""Options that answer the questions of `render.scene.new_scene`, with their kinds and helps."""


def _with_numbers(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command the options of `NUMBERS`, which it is told as ``**given``."""
    own = inspect.signature(command, eval_str=True)
    options = [
        inspect.Parameter(
            name,
            inspect.Parameter.KEYWORD_ONLY,
            default=None,
            annotation=Annotated[Optional[kind], Option(help=words)],  # noqa: UP045
        )
        for name, (kind, words) in NUMBERS.items()
    ]
    named = [one for one in own.parameters.values() if one.kind is not one.VAR_KEYWORD]
    command.__signature__ = own.replace(  # type: ignore[attr-defined]
        parameters=[*named, *options]
    )
    return command


@_with_numbers
def run(
    name: Annotated[str, Argument(help="Name of the scene.")] = "my-sensor",
    out: Annotated[Path | None, Option(help="The file (default: <name>.toml).")] = None,
    lamp: Annotated[
        Literal["fiber", "led"] | None, Option(help="Fibers turn; LEDs do not, and shine wide.")
    ] = None,
    colors: Annotated[
        str | None,
        Option(help="Of the lit edges, from left to base: red,blue,green; or one of all: white."),
    ] = None,
    camera: Annotated[
        Literal["color", "gray"] | None, Option(help="What the camera sees (default: color).")
    ] = None,
    as_json: Json = False,
    **given: float | None,
) -> None:
    """Write a commented scene file of a sensor of your own."""
    from optimize.ui.output import check_file, write_result
    from render.describe import skin_tested
    from render.geometry import counted_sites
    from render.scene import shipped_scenes, sources
    from render.scene.new_scene import Answers, check_name, scene_file
    from render.scene.scene_file import scene_from_text

    with reserved_stdout() as stream:
        check_name(name)
        path = out or Path(f"{name}.toml")
        check_file(path, (".toml",))
        if path.exists():
            raise SceneError(f"{path} is there: name another file with --out", field="out")
        if name in shipped_scenes():
            raise SceneError(
                f"name = {name} comes with tactilux, allowed: any other name", field="name"
            )
        numbers = {key: float(value) for key, value in given.items() if value is not None}
        if not numbers and {lamp, colors, camera} == {None} and sys.stdin.isatty():
            answers = _ask(name)
        else:
            named = tuple(part.strip() for part in colors.split(",")) if colors is not None else ()
            answers = Answers(name, numbers, lamp or "fiber", named, camera or "color")
        text = scene_file(answers)
        scene = scene_from_text(text, name, Path())
        try:
            sites = len(counted_sites(scene))
        except SceneError:
            raise _blind(answers) from None
        write_result(path, text.encode())
        if as_json:
            result: dict[str, object] = {"scene": scene.name, "scene_hash": scene.hash}
            print_json(stream, result | {"file": str(path), "sites": sites})
            return
        word = shlex.quote(str(path))
        assumed = sum(source.startswith("assumed") for source in sources(scene).values())
        first = scene.placed_lamps()[0]
        stream.write(
            f"{counted(sites, 'site')} on {skin_tested(scene):.0%} of the skin; "
            f"{counted(assumed, 'value')} assumed, among them: lamps {first.position[2]:g} mm "
            f"above the lower face, tilted by {math.degrees(first.tilt):g}° towards the skin. "
            f"tactilux describe {word} lists them.\n"
            f"Scene: {path}, go on with tactilux explore {word}\n"
        )


def _blind(answers: Answers) -> SceneError:
    """Return what to say where the camera sees no site whole."""
    usual = {k: v for k, v in answers.numbers.items() if k not in ("distance", "field_of_view")}
    (distance, angle), (far, whole) = answers.view, replace(answers, numbers=usual).view
    return SceneError(
        f"--distance = {distance:g} mm with --field-of-view = {angle:g} deg shows no site whole, "
        f"allowed: for example {far:g} mm with {whole:g} deg, which shows all of the pad",
        field="distance",
    )


def _ask(name: str) -> Answers:
    """Return the answers of the person at the terminal; what they cannot be is asked again."""
    from render.scene.new_scene import CAMERAS, COLORS, LAMPS, QUESTIONS, Answers

    note("Enter takes what stands in brackets; Ctrl-C ends it without a file.")
    answers = Answers(name, {})
    answers = replace(answers, lamp=_choice("lamps", tuple(LAMPS)))
    answers = replace(answers, camera=_choice("camera", CAMERAS))
    for key, question in QUESTIONS.items():
        unit = f", {question.unit}" if question.unit else ""
        while True:
            usual = "what shows the pad" if question.default is None else f"{answers.size(key):g}"
            said = _answer(f"{question.words}{unit}", usual)
            if said == usual:
                break
            try:
                answers = replace(answers, numbers={**answers.numbers, key: question.number(said)})
                break
            except SceneError as error:
                note(str(error))
    while True:
        usual = ",".join(answers.edge_colors.values())
        said = _answer(f"colors of {', '.join(answers.lit)}, of {', '.join(COLORS)}", usual)
        try:
            return replace(answers, colors=tuple(part.strip() for part in said.split(",")))
        except SceneError as error:
            note(str(error))


def _choice(question: str, kinds: tuple[str, ...]) -> str:
    """Return one of ``kinds``, of which the first is usual."""
    while (kind := _answer(f"{question}: {' or '.join(kinds)}", kinds[0])) not in kinds:
        note(f"{kind}, allowed: {', '.join(kinds)}")
    return kind


def _answer(question: str, usual: str) -> str:
    """Ask one question on stderr, where results are not."""
    print(f"{question} [{usual}]: ", end="", file=sys.stderr, flush=True)
    said = sys.stdin.readline()
    if not said:
        raise SceneError("the answers ended before the questions did: no file is written")
    return said.strip() or usual
