"""``tactilux verify``: what renders say about a design, and about the surrogate."""

from __future__ import annotations

import time
from dataclasses import asdict
from pathlib import Path
from typing import IO, TYPE_CHECKING, Annotated

from typer import Option

from optimize.cli.options import MAX_MINUTES, DesignArgument, Json, ModelFolder, SceneOfDesign
from optimize.ui.console import (
    ProgressBar,
    counted,
    note,
    print_json,
    print_table,
    reserved_stdout,
)
from render.errors import RenderError
from render.progress import in_stage

if TYPE_CHECKING:
    from optimize.readers import Reading
    from optimize.scoring import JackknifeEstimate, RenderedScore
    from optimize.verification import Verification
    from render.scene import Scene
    from surrogate.runtime import Checker

SAMPLES = 200
"""Per cell and seed, unless told otherwise."""


def run(
    path: DesignArgument,
    scene: SceneOfDesign = None,
    model: ModelFolder = None,
    samples: Annotated[
        int | None, Option(min=1, help="Samples per cell and seed (default: 200).")
    ] = None,
    minutes: Annotated[
        float | None,
        Option(min=0.1, max=MAX_MINUTES, help="Time for everything, instead of --samples."),
    ] = None,
    seeds: Annotated[int, Option(min=2, help="Number of independent seeds.")] = 4,
    out: Annotated[
        Path | None,
        Option(help="Folder of renders and result (default: <design>-renders beside it)."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Render design and baseline with error bars."""
    began = time.monotonic()
    from optimize.design import open_rated
    from optimize.readers import reading
    from optimize.scoring import model_of_design, predicted_colors
    from optimize.ui.output import check_folder
    from optimize.verification import verification_within, verify
    from render.files import write_json
    from render.reference import TimeBudget, ensure_llvm

    if samples is not None and minutes is not None:
        raise RenderError(
            "--samples and --minutes both say how long to render: give one of them", field="minutes"
        )
    with reserved_stdout() as stream:
        candidate = open_rated(path, scene)
        checkpoint = out or path.parent / f"{path.stem}-renders"
        check_folder(checkpoint)
        checker = model_of_design(candidate, model, path)
        ensure_llvm()
        numbers, each = range(1, seeds + 1), None
        count = samples or SAMPLES
        work = f"{counted(count, 'sample')} per cell" if minutes is None else f"{minutes:g} min"
        note(
            f"Rendering the baseline and {path} with {counted(seeds, 'seed')}, {work}; "
            f"interrupted, the same command goes on from {checkpoint}"
        )
        with ProgressBar("Rendering the") as bar:
            if minutes is not None:
                plan = verification_within(
                    candidate,
                    checker,
                    TimeBudget.of_minutes(minutes, began),
                    seeds=numbers,
                    folder=checkpoint,
                    progress=in_stage(bar, "baseline and design"),
                )
                count, each = plan.samples, plan.per_pass
            found = verify(
                candidate,
                checker,
                samples=count,
                seeds=numbers,
                per_pass=each,
                checkpoint=checkpoint,
                progress=bar,
            )
        readings = [
            reading(candidate.scene, predicted_colors(checker, design))
            for design in (candidate.baseline, candidate.design)
        ]
        result = found.to_json()
        result["surrogate"] |= asdict(readings[1].errors)
        kept = {
            **result,
            "level": "reference",
            "samples": count,
            "design_file": str(path),
        }
        write_json(checkpoint / f"verified-{candidate.digest}.json", kept, indent=2)
        if as_json:
            print_json(stream, result)
        else:
            _print(stream, path, candidate.scene, checker, found, readings)
            stream.write(f"Renders and result: {checkpoint}\n")


def _print(
    stream: IO[str],
    path: Path,
    scene: Scene,
    checker: Checker,
    found: Verification,
    readings: list[Reading],
) -> None:
    from optimize.design import PARTS
    from optimize.objectives import READERS
    from optimize.report import clipping_warning, guessing_warning, reader_verdict
    from optimize.scoring import prediction_checked

    word = scene.state_word
    shown = PARTS[2:] if word else PARTS[2:-1]
    spreads = ("spread over sites", *([f"spread over {word}s"] if word else []))

    def row(part: str, score: JackknifeEstimate, measured: RenderedScore | None) -> tuple[str, ...]:
        low, high = score.interval()
        read = [f"{found.error(reader, part).shown()}°" for reader in READERS]
        parts = [measured.parts[name].shown() if measured else "" for name in shown]
        return part.capitalize(), *read, score.shown(), f"{low:.2f} to {high:.2f}", *parts

    print_table(
        stream,
        f"{path}, reference (bidirectional, MIS)",
        ("design", "sensor reader", "place reader", "score S", "95% interval", *spreads),
        [
            row("baseline", found.baseline.score, found.baseline),
            row("design", found.design.score, found.design),
            row("difference", found.difference, None),
        ],
    )
    reads = reader_verdict(
        ("the baseline", "the design"), (readings[0].sensor.mean, readings[1].sensor.mean)
    )
    error, se = found.surrogate_score - found.design.score.value, found.design.score.se
    checked = prediction_checked(
        error, checker.score_half_width, se, checker.coverage, converged=not found.doubt
    )
    stream.write(
        "".join(f"{sentence}\n" for sentence in found.conclusions)
        + f"By the {checker.level} {reads}.\n"
        f"The {checker.level} said {found.surrogate_score:.2f}, {checked}.\n"
        f"{counted(len(found.seeds), 'seed')}, {found.difference.replicates} replicates, "
        f"{counted(found.samples, 'sample')} per cell, {found.render_seconds:.0f} s of rendering.\n"
    )
    doubts = guessing_warning(scene, readings[1].sensor.mean)
    for warning in doubts + clipping_warning(found.design.clipped):
        stream.write(f"Note: {warning}\n")
