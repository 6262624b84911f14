"""``tactilux hw calibrate``: photographs in, calibrated scene and report out."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import IO, Annotated, Any

from typer import Option

from hw.cli.options import Photographs, Renders, SceneOption, grouped
from optimize.cli.options import DesignOption, Json, ModelFolder
from optimize.ui.console import print_json, reserved_stdout


@dataclass(frozen=True)
class ColorSweeps:
    """Sweeps in single colors, as the options of the command line say."""

    red: Annotated[
        Path | None, Option(help="Folder of the flat sweep in red alone, for the response matrix.")
    ] = None
    green: Annotated[Path | None, Option(help="The same in green.")] = None
    blue: Annotated[Path | None, Option(help="The same in blue.")] = None
    color: Annotated[
        list[str] | None,
        Option(metavar="NAME=FOLDER", help="The same in any LED color of the scene; repeat it."),
    ] = None


@grouped
def run(
    flat: Annotated[Path, Option(help="Folder of the sweep with the flat pad.")],
    additive: Annotated[
        Path,
        Option("--linearity", help="Folder of a sweep with all fibers together as well."),
    ],
    bent: Annotated[
        Path | None, Option(help="Folder of the sweep with the bent pad, where it bends.")
    ] = None,
    bend: Annotated[
        float, Option(min=1.0, max=180.0, help="Total angle of the bent pad in degrees.")
    ] = 90.0,
    scene_name: SceneOption = "finger20",
    design: DesignOption = None,
    model: ModelFolder = None,
    out: Annotated[
        Path | None, Option(help="Result directory (default: runs/<scene>-calibrate).")
    ] = None,
    *,
    colors: ColorSweeps,
    photographs: Photographs,
    renders: Renders,
    as_json: Json = False,
) -> None:
    """Fit material, powers and gains to photographs of single fibers."""
    import numpy as np

    from hw.calibration.material import check_one_shot, material_space
    from hw.errors import CalibrationError
    from optimize.ui.output import check_target
    from render.scene import load_scene

    with reserved_stdout() as stream:
        scene = load_scene(scene_name)
        check_one_shot(scene)
        material_space(scene)
        if scene.bending.rigid == (bent is not None):
            raise CalibrationError(
                f"scene {scene.name} {'is rigid' if scene.bending.rigid else 'bends'}, allowed: "
                f"{'--flat alone' if scene.bending.rigid else '--flat and --bent'}",
                field="bent",
            )
        named = asdict(colors)
        in_colors = color_folders(scene.palette.names, named, named.pop("color") or [])
        target = out or Path("runs") / f"{scene.name}-calibrate"
        check_target(target)
        reader = photographs.reader(scene)
        photos = [reader.sweep(folder) for folder in (flat, bent) if folder]
        together, by_color = reader.sweep(additive), [reader.sweep(one) for one in in_colors]
        # Only now what takes seconds to load.
        from hw.calibration.calibration import Sweeps, calibrate_sets

        result = calibrate_sets(
            scene,
            Sweeps(
                by_bend=photos,
                bends=np.array([0.0, math.radians(bend)][: len(photos)]),
                additive=together,
                by_color=by_color,
                noise=photographs.noise,
            ),
            design=design,
            model=model,
            target=target,
            materials=renders.materials,
            samples=renders.samples,
        )
        if as_json:
            print_json(stream, result)
        else:
            print_calibration(stream, result)


def color_folders(
    names: tuple[str, ...], options: dict[str, Path | None], told: list[str]
) -> list[Path]:
    """Return the folder of the sweep in each of the LED colors ``names``, in their order, or none.

    ``options`` are those of --red, --green and --blue, ``told`` is what --color says, each
    ``NAME=FOLDER``.

    Raises:
        CalibrationError: no such color, one twice, or some of them alone.
    """
    from hw.errors import CalibrationError

    given = [(f"--{name}", name, folder) for name, folder in options.items() if folder]
    for item in told:
        name, equals, folder = item.partition("=")
        if not equals or not folder:
            raise CalibrationError(
                f"--color {item} is not like NAME=FOLDER, allowed: {names[0]}={names[0]} and so on",
                field="color",
            )
        given.append((f"--color {item}", name, Path(folder)))
    folders: dict[str, Path] = {}
    for option, name, folder_of in given:
        if name not in names or name in folders:
            problem = "is given twice" if name in folders else "is no LED color of the scene"
            raise CalibrationError(
                f"{option}: {name} {problem}, allowed: {', '.join(names)}, each once",
                field="color",
            )
        folders[name] = folder_of
    if len(folders) not in (0, len(names)):
        options_of = [f"--{name}" if name in options else f"--color {name}=" for name in names]
        raise CalibrationError(
            f"{len(folders)} of {_listed(options_of)} are given, allowed: all or none",
            field="response",
        )
    return [folders[name] for name in names if name in folders]


def _listed(names: list[str]) -> str:
    """Return names as a sentence lists them.

    >>> _listed(["--color white="]), _listed(["--red", "--green", "--blue"])
    ('--color white=', '--red, --green and --blue')
    """
    *most, last = names
    return f"{', '.join(most)} and {last}" if most else last


def print_calibration(stream: IO[str], result: dict[str, Any]) -> None:
    """Write the fitted values and where everything is."""
    from hw.calibrated_powers import FILE

    for row in result["material"].values():
        value = f"{row['value']:.4g} {row['unit']}".rstrip()
        interval = "{:.4g} to {:.4g}".format(*row["interval"])
        stream.write(
            f"{row['title']:<20} {value:>14}   95 % {interval:<20} (before: {row['before']:.4g})\n"
        )
    for color, told in (result["response"] or {}).items():
        seen = ", ".join(
            f"{channel} {value:.3f} ({low:.3f} to {high:.3f})"
            for channel, value, (low, high) in zip(
                result["channels"], told["value"], told["interval"], strict=True
            )
        )
        stream.write(f"{color} LEDs are seen by: {seen}\n")
    for caveat in result["caveats"]:
        stream.write(f"{caveat}\n")
    confirmation = result["confirmation"]
    if confirmation:
        stream.write(
            f"Confirmed: along the reference lines, renders of the calibrated scene differ from "
            f"the photographs by {100 * confirmation['rms']:.1f} % rms (noise explains "
            f"{100 * confirmation['noise']:.1f} %; before calibration: "
            f"{100 * confirmation['before']:.1f} %).\n"
        )
    else:
        stream.write("Neither corrected nor confirmed by renders: --samples 1000 does both.\n")
    file = Path(result["scene"]).with_name(FILE)
    stream.write(
        f"Scene: {result['scene']}\nReport: {result['report']}\n"
        f"Powers: {file}, which `tactilux check` and `tactilux hw set` take with --calibration\n"
        f"Next: `tactilux train {result['scene']}` makes the calibrated scene's model, then "
        f"`tactilux explore {result['scene']}`\n"
    )
