"""``tactilux compare``: designs of one scene side by side, on its model or by renders."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from optimize.cli.options import Json, ModelFolder, SceneOfDesign
from optimize.ui.console import (
    ProgressBar,
    counted,
    note,
    print_json,
    print_table,
    reserved_stdout,
)
from render.errors import DesignError


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
    """Compare designs: scores, and differences with intervals."""
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
    from optimize.scoring import open_model, search_table
    from optimize.ui.output import check_file
    from optimize.verification import reference_renders, score_allocation
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
        sensor, designs = name_designs(paths, scene)
        checker = open_model(sensor, model)
        found = compare_on_model(checker, sensor, designs)
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
                render = reference_renders(sensor, checkpoint, bar)
                stages = found.stages
                found = compare_by_renders(
                    found,
                    render,
                    samples=samples,
                    seeds=range(1, seeds + 1),
                    allocation=score_allocation(
                        sensor,
                        search_table(checker),
                        stages[0].settings,
                        [stage.design for stage in stages],
                    ),
                )
        if out is not None:
            write_comparison(out, found, files)
        if as_json:
            result: dict[str, object] = {
                "scene": sensor.name,
                "scene_hash": sensor.hash,
                "level": found.level,
                "designs": [
                    {"name": entry.name, "file": str(entry.file), **stage_to_json(stage)}
                    for entry, stage in zip(designs, found.stages, strict=True)
                ],
                "differences": [
                    {
                        "first": one.first,
                        "second": one.second,
                        "value": one.value,
                        "interval": list(one.interval),
                        "better": one.better,
                        "recolored": one.recolored,
                        "turned_deg": one.turned,
                    }
                    for one in found.differences
                ],
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
            "Differences in S",
            ("pair", "in S", f"{found.coverage:.0%} interval", "verdict", "recolored", "turned"),
            difference_rows(found),
            below=found.covers,
        )
        if out is not None:
            stream.write(f"Page: {out}, open it in a browser\n")
