"""``tactilux reconstruct``: what a design is worth in degrees of normals, and in depth."""

from __future__ import annotations

import math
from pathlib import Path
from typing import IO, TYPE_CHECKING, Annotated

from typer import BadParameter, Option

from optimize.cli.options import (
    MAX_SMOOTHING,
    Json,
    MeshUnit,
    ModelFolder,
    RatedDesignArgument,
    SceneOfDesign,
    Seed,
)
from optimize.ui.console import ProgressBar, note, print_json, print_table, reserved_stdout
from render.errors import DesignError
from render.levels import PREVIEW, REFERENCE, level_name

if TYPE_CHECKING:
    from optimize.design import Design, RatedDesign
    from optimize.readers import CameraModel, DepthReading, ErrorComparison
    from render.arrays import Array
    from render.geometry import HeightMap, Imprint
    from render.mesh_units import Unit
    from render.scene import Scene
    from surrogate.runtime import Checker

RENDER_SEED = 700
SHAPES = {"ball": "a ball", "edge": "an edge", "bolt": "a bolt"}
"""What can be pressed in without a file, and what pages call it."""
PRESS_DEPTH = 0.4
"""How deep ball, bolt and edge are pressed in, mm: the ball then slopes by 30 deg at its rim."""


def run(
    path: RatedDesignArgument,
    scene: SceneOfDesign = None,
    model: ModelFolder = None,
    read_noise: Annotated[
        float | None, Option(min=0.0, help="Read noise in counts (default: the scene's camera).")
    ] = None,
    full_well: Annotated[
        float | None,
        Option(min=1.0, help="Photoelectrons at 255 counts (default: the scene's camera)."),
    ] = None,
    samples: Annotated[
        int | None, Option(min=1, help="Use renders with so many samples per cell instead.")
    ] = None,
    press: Annotated[
        str | None,
        Option(
            help="Read the depth of what is pressed in instead: ball, edge, bolt, or the lower "
            "side of an STL, PLY or OBJ file."
        ),
    ] = None,
    depth: Annotated[
        float | None,
        Option(min=0.01, help=f"--press: how deep, mm (default: {PRESS_DEPTH:g}; files 1)."),
    ] = None,
    smooth: Annotated[
        float | None,
        Option(
            min=0.0,
            max=MAX_SMOOTHING,
            help="--press: over how many mm skin rounds what is sharp (default: 0.3).",
        ),
    ] = None,
    unit: MeshUnit = None,
    out: Annotated[
        Path | None, Option(help="--press: page to write (default: beside the design).")
    ] = None,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Recover normals from colors, in degrees, or depth of a press."""
    from optimize.design import open_rated
    from optimize.readers import SEEDS, CameraModel, compare_readings, reading
    from optimize.scoring import model_of_design, predicted_colors
    from optimize.ui.output import check_file

    for name, value in (("read-noise", read_noise), ("full-well", full_well)):
        if value is not None and not math.isfinite(value):
            raise DesignError(f"--{name} = {value}, allowed: a finite number", field=name)
    if press is None:
        pressing = {"--depth": depth, "--smooth": smooth, "--unit": unit, "--out": out}
        given = [option for option, value in pressing.items() if value is not None]
        if given:
            raise BadParameter(f"{given[0]} is for --press, which says what is pressed in")
    elif samples is not None:
        raise BadParameter("give --samples or --press, not both: pressed pictures are previews")
    with reserved_stdout() as stream:
        candidate = open_rated(path, scene)
        camera = CameraModel.of(candidate.scene)
        camera = camera.stating(read_noise=read_noise, full_well=full_well)
        if press is not None:
            from optimize.report import print_depths, write_depths

            skin = _pressed(candidate.scene, press, depth, smooth, unit)
            page = out or path.with_name(f"{path.stem}-depth-{Path(press).stem}.html")
            check_file(page, (".html", ".htm"))
            checker = model_of_design(candidate, model, path)
            read = _depths(candidate, skin, checker, camera, seed)
            name = SHAPES.get(press, Path(press).name)
            write_depths(page, candidate.scene, name, read, camera, seed)
            if as_json:
                print_json(stream, _depths_to_json(read, press, camera, page))
            else:
                title = f"{path}, {level_name(PREVIEW, None)}: depth of {name}"
                print_depths(stream, title, read)
                stream.write(f"{page}\n")
            return
        designs = [candidate.baseline, candidate.design]
        if samples is None:
            checker = model_of_design(candidate, model, path)
            level, effort = checker.level, checker.effort
            known = shown = [predicted_colors(checker, design) for design in designs]
        else:
            known, shown = _rendered(path, candidate, designs, samples, seed)
            level, effort = REFERENCE, None
        seeds = range(seed, seed + SEEDS)
        found = compare_readings(
            *(
                reading(candidate.scene, learned, camera, seeds, seen)
                for learned, seen in zip(known, shown, strict=True)
            )
        )
        result: dict[str, object] = {
            "level": level,
            "effort": effort,
            "read_noise": camera.read_noise,
            "full_well": camera.full_well,
            "samples": samples,
            **{name: entry.to_json() for name, entry in found.items()},
        }
        if as_json:
            print_json(stream, result)
        else:
            _print(stream, path, level_name(level, effort), camera, found)


def _pressed(
    scene: Scene, press: str, depth: float | None, smooth: float | None, unit: Unit | None
) -> Imprint | HeightMap:
    """Return what is pressed in."""
    from optimize.readers import check_flat
    from render.geometry import HeightMap, probe
    from render.geometry.height_map import SMOOTHING
    from render.refused_values import did_you_mean

    check_flat(scene)
    if press not in SHAPES and not Path(press).is_file():
        raise BadParameter(
            f"--press {press}, allowed: {', '.join(SHAPES)} or a mesh file"
            f"{did_you_mean(press, tuple(SHAPES))}"
        )
    if press in SHAPES and depth is None:
        depth = PRESS_DEPTH
    skin = probe(scene, press, depth, SMOOTHING if smooth is None else smooth, unit)
    assert skin is not None
    if isinstance(skin, HeightMap) and skin.about:
        note(f"{skin.about}.")
    return skin


def _depths(
    candidate: RatedDesign, skin: Imprint | HeightMap, checker: Checker, camera: CameraModel,
    seed: int,
) -> dict[str, DepthReading]:  # fmt: skip
    """Return what baseline and design read of a pressed ``skin``, each at its own exposure."""
    from optimize.readers import ExposedColors, ExposedDesign, read_press
    from optimize.scoring import predicted_colors

    lights = []
    for design in (candidate.baseline, candidate.design):
        one = ExposedColors.of(predicted_colors(checker, design), camera)
        lights.append(ExposedDesign(design, one.factor, one.gain))
    exposure = candidate.settings.exposure
    with ProgressBar("Reading the depth") as bar:
        found = read_press(candidate.scene, skin, lights, exposure, camera, seed, bar)
    return dict(zip(("baseline", "design"), found, strict=True))


def _depths_to_json(
    read: dict[str, DepthReading], press: str, camera: CameraModel, page: Path
) -> dict[str, object]:
    """Return what programs rely on."""
    return {
        "level": PREVIEW,
        "press": press,
        "read_noise": camera.read_noise,
        "full_well": camera.full_well,
        "page": str(page),
        **{key: one.to_json() for key, one in read.items()},
    }


def _rendered(
    path: Path, candidate: RatedDesign, designs: list[Design], samples: int, seed: int
) -> tuple[list[Array], list[Array]]:
    """Return colors of two independent halves of a render: to learn from, and to be shown."""
    from optimize.verification import reference_renders
    from render.reference import ensure_llvm

    ensure_llvm()
    checkpoint = path.parent / f"{path.stem}-renders"
    note(f"Rendering baseline and design; interrupted, it goes on from {checkpoint}")
    with ProgressBar("Rendering") as bar:
        renders = reference_renders(candidate.scene, checkpoint, bar)(
            designs, samples=samples, seeds=[RENDER_SEED + seed], title="baseline and design"
        )
    colors = renders.colors(candidate.rating.settings)
    even, odd = (list(colors[half::2].mean(axis=0)) for half in (0, 1))
    return even, odd


def _print(
    stream: IO[str], path: Path, level: str, camera: CameraModel, found: dict[str, ErrorComparison]
) -> None:
    from optimize.readers import SEEDS

    rows = [
        (
            name.replace("_", ", "),
            f"{entry.baseline:.2f}",
            f"{entry.design:.2f}",
            f"{entry.difference:+.2f}",
            f"{entry.interval[0]:+.2f} to {entry.interval[1]:+.2f}",
        )
        for name, entry in found.items()
    ]
    print_table(
        stream,
        f"{path}, {level}: errors in degrees",
        ("reader", "baseline", "design", "difference", "95% interval"),
        rows,
    )
    stream.write(
        f"{camera.sentence}\nEach design has its own exposure. Intervals are over {SEEDS} draws of "
        "normals and noise.\n"
    )
    if level == REFERENCE:
        stream.write("Render noise is part of the errors: readers learn from other replicates.\n")
