"""``tactilux verify``: what level 2 says about a design, and about the surrogate."""

from __future__ import annotations

from pathlib import Path
from typing import IO, TYPE_CHECKING, Annotated

from typer import Option

from optimize.cli.options import DesignArgument, Json, ModelFolder, SceneOfDesign
from optimize.ui.console import (
    ProgressBar,
    counted,
    note,
    print_json,
    print_table,
    reserved_stdout,
)
from render.errors import RenderError

if TYPE_CHECKING:
    from optimize.design import RatedDesign
    from optimize.scoring import JackknifeEstimate, RenderedScore
    from optimize.verification import Verification
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
        float | None, Option(min=0.1, help="Rendering time, instead of --samples.")
    ] = None,
    seeds: Annotated[int, Option(min=2, help="Number of independent seeds.")] = 4,
    as_json: Json = False,
) -> None:
    """Render design and baseline with error bars."""
    from optimize.design import open_rated
    from optimize.scoring import open_model
    from optimize.verification import verify
    from render.files import write_json
    from render.reference import ensure_llvm

    if samples is not None and minutes is not None:
        raise RenderError(
            "--samples and --minutes both say how long to render: give one of them",
            field="minutes",
            value=minutes,
        )
    with reserved_stdout() as stream:
        candidate = open_rated(path, scene)
        checker = open_model(candidate.scene, model)
        ensure_llvm()
        checkpoint = path.parent / f"{path.stem}-renders"
        count = samples or _count(candidate, minutes, seeds, checkpoint)
        note(
            f"Rendering the baseline and {path} with {counted(seeds, 'seed')}, "
            f"{counted(count, 'sample')} per cell; "
            f"interrupted, the same command goes on from {checkpoint}"
        )
        with ProgressBar("Rendering the") as bar:
            found = verify(
                candidate,
                checker,
                samples=count,
                seeds=range(1, seeds + 1),
                checkpoint=checkpoint,
                progress=bar,
            )
        kept = {
            **found.to_json(),
            "level": "reference",
            "samples": count,
            "design_file": str(path),
        }
        write_json(checkpoint / f"verified-{candidate.digest}.json", kept, indent=2)
        if as_json:
            print_json(stream, found.to_json())
        else:
            _print(stream, path, checker, found)


def _count(candidate: RatedDesign, minutes: float | None, seeds: int, folder: Path) -> int:
    if minutes is None:
        return SAMPLES
    from optimize.verification import affordable_samples

    note("Timing two short renders")
    return affordable_samples(
        candidate.scene,
        candidate.design.phi,
        minutes=minutes,
        seeds=seeds,
        designs=1 if candidate.recolored else 2,
        folder=folder,
    )


def _print(stream: IO[str], path: Path, checker: Checker, found: Verification) -> None:
    from optimize.design import PARTS
    from optimize.scoring import prediction_checked

    def row(name: str, score: JackknifeEstimate, measured: RenderedScore | None) -> tuple[str, ...]:
        low, high = score.interval()
        parts = [_pm(measured.parts[part]) if measured else "" for part in PARTS[1:]]
        return name, _pm(score), f"{low:.2f} to {high:.2f}", *parts

    print_table(
        stream,
        f"{path}, reference (bidirectional, MIS)",
        ("design", "score S", "95% interval", "mean M", "spread over sites", "spread over bends"),
        [
            row("Baseline", found.baseline.score, found.baseline),
            row("Design", found.design.score, found.design),
            row("Difference", found.difference, None),
        ],
    )
    error, se = found.surrogate_score - found.design.score.value, found.design.score.se
    checked = prediction_checked(error, checker.score_half_width, se, checker.coverage)
    stream.write(
        f"{found.conclusion}\n"
        f"The surrogate said {found.surrogate_score:.2f}, {checked}.\n"
        f"{counted(len(found.seeds), 'seed')}, {found.difference.replicates} replicates, "
        f"{counted(found.samples, 'sample')} per cell, {found.render_seconds:.0f} s of rendering.\n"
    )


def _pm(estimate: JackknifeEstimate) -> str:
    return f"{estimate.value:.2f} ± {estimate.se:.2f}"
