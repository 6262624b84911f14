"""``tactilux reconstruct``: what a design's score is worth in degrees of surface normal."""

from __future__ import annotations

import math
from pathlib import Path
from typing import IO, TYPE_CHECKING, Annotated

from typer import Option

from optimize.cli.options import Json, ModelFolder, RatedDesignArgument, SceneOfDesign, Seed
from optimize.ui.console import ProgressBar, note, print_json, print_table, reserved_stdout
from render.errors import DesignError

if TYPE_CHECKING:
    from optimize.design import Design, RatedDesign
    from optimize.reconstruction import CameraNoise, ErrorComparison
    from render.arrays import Array

RENDER_SEED = 700


def run(
    path: RatedDesignArgument,
    scene: SceneOfDesign = None,
    model: ModelFolder = None,
    read_noise: Annotated[float, Option(min=0.0, help="Read noise of the camera in counts.")] = 1.0,
    full_well: Annotated[
        float, Option(min=1.0, help="Photoelectrons at 255 counts, for the shot noise.")
    ] = 10000.0,
    samples: Annotated[
        int | None, Option(min=1, help="Use renders with so many samples per cell instead.")
    ] = None,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Recover surface normals from the colors, in degrees."""
    from optimize.design import open_rated
    from optimize.reconstruction import (
        SEEDS,
        CameraNoise,
        compare_reconstruction,
        predicted_colors,
    )
    from optimize.scoring import model_of_design

    for name, value in (("read-noise", read_noise), ("full-well", full_well)):
        if not math.isfinite(value):
            raise DesignError(f"--{name} = {value}, allowed: a finite number", field=name)
    with reserved_stdout() as stream:
        candidate = open_rated(path, scene)
        designs = [candidate.baseline, candidate.design]
        if samples is None:
            checker = model_of_design(candidate, model, path)
            level: str = checker.level
            pairs = [predicted_colors(checker, candidate.scene, design) for design in designs]
            known = shown = pairs
        else:
            known, shown = _rendered(path, candidate, designs, samples, seed)
            level = "reference"
        noise = CameraNoise(read_noise, full_well)
        seeds = range(seed, seed + SEEDS)
        found = compare_reconstruction(candidate.scene, known, shown, noise, seeds)
        result: dict[str, object] = {
            "level": level,
            "read_noise": read_noise,
            "full_well": full_well,
            "samples": samples,
            **{name: entry.to_json() for name, entry in found.items()},
        }
        if as_json:
            print_json(stream, result)
        else:
            _print(stream, path, level, noise, found)


def _rendered(
    path: Path, candidate: RatedDesign, designs: list[Design], samples: int, seed: int
) -> tuple[list[tuple[Array, Array]], list[tuple[Array, Array]]]:
    """Return colors of two independent halves of a render: to learn from, and to be shown."""
    import numpy as np

    from optimize.verification import reference_renders
    from render.metric import superposed
    from render.reference import ensure_llvm

    ensure_llvm()
    checkpoint = path.parent / f"{path.stem}-renders"
    note(f"Rendering baseline and design; interrupted, it goes on from {checkpoint}")
    with ProgressBar("Rendering") as bar:
        renders = reference_renders(candidate.scene, checkpoint, bar)(
            designs, samples=samples, seeds=[RENDER_SEED + seed], title="baseline and design"
        )
    exposure, halves = candidate.rating.settings.exposure, []
    for half in (slice(0, None, 2), slice(1, None, 2)):
        facets = renders.replicates[half].mean(axis=0)
        pads = renders.background[half].mean(axis=0)
        halves.append(
            [
                (
                    exposure * superposed(facets[i], design.power),
                    exposure * superposed(np.expand_dims(pads[i], 3), design.power)[:, :, 0],
                )
                for i, design in enumerate(designs)
            ]
        )
    return halves[0], halves[1]


def _print(
    stream: IO[str], path: Path, level: str, noise: CameraNoise, found: dict[str, ErrorComparison]
) -> None:
    from optimize.design import LEVEL_NAMES
    from optimize.reconstruction import SEEDS

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
        f"{path}, level {LEVEL_NAMES[level]}: errors in degrees",
        ("reader", "baseline", "design", "difference", "95% interval"),
        rows,
    )
    stream.write(
        f"Camera noise: read {noise.read:g} counts, shot noise of {noise.full_well:g} electrons "
        f"at 255 counts, rounding. Intervals are over {SEEDS} draws of normals and noise.\n"
    )
    if level == "reference":
        stream.write("Render noise is part of the errors: readers learn from other replicates.\n")
