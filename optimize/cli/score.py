"""``tactilux score``: rate a layout drawn by hand, or a design again."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from optimize.cli.options import Coarse, Json, ModelFolder, SceneOfDesign
from optimize.ui.console import print_json, reserved_stdout


def run(
    path: Annotated[
        Path, Argument(metavar="design", help="JSON or TOML with colors and angles_deg.")
    ],
    scene: SceneOfDesign = None,
    model: ModelFolder = None,
    coarse: Coarse = False,
    out: Annotated[Path | None, Option(help="Write the rated design to this .json file.")] = None,
    as_json: Json = False,
) -> None:
    """Rate a layout drawn by hand on the surrogate."""
    from optimize.design import dimmed_baseline, load_layout, save_design
    from optimize.exploration import rate, stage_to_json
    from optimize.report import (
        clipping_warning,
        doubted_gain,
        guessing_warning,
        holder_warning,
        preview_warnings,
        print_scores,
        reader_verdict,
    )
    from optimize.scoring import open_model
    from optimize.ui.output import check_file, writable
    from surrogate.runtime import RankingTest

    with reserved_stdout() as stream:
        if out is not None:
            check_file(out, (".json",))
        sensor, design = load_layout(path, scene)
        checker = open_model(sensor, model, coarse=coarse)
        first = rate(checker, sensor, "baseline", "Baseline", "", dimmed_baseline(sensor))
        found = rate(checker, sensor, "design", "Design", "", design)
        ranking = RankingTest.of(checker.metadata)
        doubts = [] if ranking.reliable else [ranking.advice()]
        doubts += preview_warnings(sensor, checker.level, found.photon_noise)
        doubts += guessing_warning(sensor, found.reader_error)
        doubts += holder_warning(sensor, design)
        doubts += clipping_warning(found.clipped)
        if out is not None:
            with writable(out):
                save_design(out, design, sensor, found.rating)
        if as_json:
            result: dict[str, object] = {
                "scene": sensor.name,
                "scene_hash": sensor.hash,
                "baseline": stage_to_json(first),
                "design": stage_to_json(found),
                "difference": found.rating.score - first.rating.score,
                "warnings": doubts,
            }
            print_json(stream, result)
            return
        for doubt in doubts:
            stream.write(f"Note: {doubt}\n")
        print_scores(stream, (first, found), checker.coverage)
        errors = first.reader_error, found.reader_error
        reads = reader_verdict(("the baseline", "the design"), errors)
        gain = found.rating.score - first.rating.score
        doubt = doubted_gain(design, ranking)
        if not doubt and abs(gain) <= 2.0 * checker.score_half_width:
            doubt = "the intervals overlap"
        stream.write(
            f"The design scores {gain:+.1f} against the baseline"
            f"{f', but {doubt}' if doubt else ''}; {reads}.\n"
        )
        if out is not None:
            stream.write(f"Design: {out}\n")
