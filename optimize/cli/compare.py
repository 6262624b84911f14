"""``tactilux compare``: designs side by side, on their models or by renders."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from optimize.cli.options import Json, ModelFolder, SceneOfDesign
from optimize.objectives import ERROR_KEYS
from optimize.ui.console import (
    ProgressBar,
    counted,
    note,
    print_json,
    print_table,
    reserved_stdout,
)
from render.errors import DesignError

if TYPE_CHECKING:
    from optimize.comparison import DesignDifference


def run(
    paths: Annotated[
        list[Path],
        Argument(metavar="designs", help="Design files, layouts, or directories of runs."),
    ],
    scene: SceneOfDesign = None,
    model: ModelFolder = None,
    samples: Annotated[
        int | None,
        Option(min=1, help="Render all designs, with so many samples per cell and seed."),
    ] = None,
    seeds: Annotated[int, Option(min=2, help="Number of independent seeds of --samples.")] = 4,
    out: Annotated[
        Path | None, Option(help="Write a page with pictures side by side to this .html file.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Compare designs: degrees, S, and differences with intervals."""
    from optimize.comparison import (
        LETTERS,
        compare_by_renders,
        compare_on_model,
        difference_rows,
        name_designs,
        write_comparison,
    )
    from optimize.exploration import stage_to_json
    from optimize.report import print_scores
    from optimize.scoring import open_model
    from optimize.ui.output import check_file
    from optimize.verification import reference_renders
    from render.reference import ensure_llvm

    if not 2 <= len(paths) <= len(LETTERS):
        raise DesignError(
            f"{counted(len(paths), 'design')} given, allowed: 2 to {len(LETTERS)}: name design "
            "files, or directories of runs",
            field="designs",
        )
    with reserved_stdout() as stream:
        if out is not None:
            check_file(out, (".html", ".htm"))
        designs = name_designs(paths, scene)
        sensors = {one.scene.hash: one.scene for one in designs}
        if model is not None and len(sensors) > 1:
            raise DesignError(
                f"--model {model} is of one scene, allowed: no --model with designs of "
                f"{len(sensors)} scenes",
                field="model",
            )
        models = {key: open_model(sensor, model) for key, sensor in sensors.items()}
        found = compare_on_model(designs, models)
        files = [entry.file for entry in designs]
        if samples is not None:
            ensure_llvm()
            checkpoint = files[0].parent / "compare-renders"
            note(
                f"Rendering {counted(len(files), 'design')} with {counted(seeds, 'seed')}, "
                f"{counted(samples, 'sample')} per cell; interrupted, the same command goes on "
                f"from {checkpoint}"
            )
            with ProgressBar("Rendering the") as bar:
                found = compare_by_renders(
                    found,
                    lambda sensor: reference_renders(sensor, checkpoint, bar),
                    models,
                    samples=samples,
                    seeds=range(1, seeds + 1),
                )
        if out is not None:
            write_comparison(out, found, files)
        if as_json:
            result: dict[str, object] = {
                "level": found.stages[0].rating.level,
                "effort": found.stages[0].rating.effort,
                "designs": [
                    {
                        "name": entry.name,
                        "file": str(entry.file),
                        "scene": entry.scene.name,
                        "scene_hash": entry.scene.hash,
                        **stage_to_json(stage),
                    }
                    for entry, stage in zip(designs, found.stages, strict=True)
                ],
                "differences": [_difference_to_json(one) for one in found.differences],
                "coverage": found.coverage,
                "covers": found.covers,
                "warnings": list(found.warnings),
                "page": None if out is None else str(out),
            }
            print_json(stream, result)
            return
        for warning in found.warnings:
            stream.write(f"Note: {warning}\n")
        for stage, file in zip(found.stages, files, strict=True):
            stream.write(f"{stage.key}: {file}\n")
        letters = [replace(stage, title=stage.key) for stage in found.stages]
        print_scores(stream, letters, found.coverage)
        print_table(
            stream,
            "Differences, with intervals",
            ("pair", "sensor reader", "place reader", "score S", "verdict", "recolored", "turned"),
            difference_rows(found),
            below=found.covers,
        )
        if out is not None:
            stream.write(f"Page: {out}, open it in a browser\n")


def _difference_to_json(one: DesignDifference) -> dict[str, object]:
    """Return a difference for programs: degrees by reader, and S in one scene, with intervals."""
    told: dict[str, object] = {"first": one.first, "second": one.second}
    value, interval = one.score or (None, None)
    told |= {"value": value, "interval": interval and list(interval)}
    for reader, key in ERROR_KEYS.items():
        degrees, ends = one.errors[reader]
        told |= {f"{key}_deg": degrees, f"{key}_interval": list(ends)}
    return told | {
        "better": one.better,
        "better_in_score": one.better_in_score,
        "recolored": one.recolored,
        "turned_deg": one.turned,
    }
