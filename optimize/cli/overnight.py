"""``tactilux overnight``: in the evening a scene, in the morning a verified design."""

from __future__ import annotations

import sys
from dataclasses import asdict
from pathlib import Path
from typing import IO, TYPE_CHECKING, Annotated

from typer import BadParameter, Option

from optimize.cli.options import MAX_MINUTES, Json, Objective, SceneName, Seed
from optimize.objectives import ERROR_KEYS, READERS
from optimize.ui.console import note, print_json, print_table, reserved_stdout

if TYPE_CHECKING:
    from optimize.overnight.result import OvernightResult
    from optimize.overnight.workers import Workers


def run(
    scene_name: SceneName = "finger20",
    out: Annotated[
        Path | None, Option(help="Run directory (default: runs/<scene>-overnight).")
    ] = None,
    hours: Annotated[
        float | None,
        Option(
            min=0.01,
            max=MAX_MINUTES / 60,
            help="Time for everything, over all attempts (default: 8).",
        ),
    ] = None,
    samples: Annotated[
        int | None, Option(min=1, help="A fixed amount of work instead: per cell of the table.")
    ] = None,
    workers: Annotated[
        int | None, Option(min=1, help="Render in so many processes on this machine.")
    ] = None,
    dask: Annotated[
        str | None, Option(help="Render on the workers of a Dask scheduler, tcp://host:8786.")
    ] = None,
    objective: Objective = None,
    seed: Seed = 0,
    as_json: Json = False,
    json_lines: Annotated[
        bool, Option("--json-lines", help="Print progress as JSON, one object per line.")
    ] = False,
) -> None:
    """Search and verify by hours of rendering; resumable."""
    for first, second, both in (
        ("--hours", "--samples", hours is not None and samples is not None),
        ("--workers", "--dask", workers is not None and dask is not None),
    ):
        if both:
            raise BadParameter(f"give {first} or {second}, not both")
    from optimize.overnight.job import overnight
    from optimize.overnight.run_directory import check_run_directory
    from optimize.placement import with_places
    from optimize.ui.process import Stopped
    from render.reference import ensure_llvm
    from render.scene import load_scene

    with reserved_stdout() as stream:
        sensor = load_scene(scene_name)
        scene = with_places(sensor)
        target = out or Path("runs") / f"{sensor.name}-overnight"
        check_run_directory(target)
        if dask is None:
            ensure_llvm()

        def make_workers() -> Workers:
            from optimize.overnight.workers import LocalWorker

            if workers is None and dask is None:
                return LocalWorker()
            from optimize.overnight.dask_workers import DaskWorkers

            return DaskWorkers(workers=workers, address=dask)

        note(f"Everything is kept in {target}; interrupted, the same command goes on from there")
        try:
            result = overnight(
                scene,
                target,
                hours=None if samples else hours or 8.0,
                samples=samples,
                seed=seed,
                objective=objective or "sensor",
                make_workers=make_workers,
                lines=stream if json_lines else None,
            )
        except Stopped as stop:
            sys.exit(stop.code)
        if as_json or json_lines:
            print_json(stream, result_to_json(result, target))
        else:
            _print(stream, result, target)


def result_to_json(result: OvernightResult, target: Path) -> dict[str, object]:
    """Return what programs rely on; ``design`` is the path of the design that is handed over."""
    from optimize.overnight.result import DESIGNS
    from optimize.overnight.run_directory import REPORT
    from optimize.overnight.status import status_of

    status = status_of(target)
    return {
        "scene": result.scene.name,
        "scene_hash": result.scene.hash,
        "level": "reference",
        "objective": result.objective,
        "winner": result.winner,
        "design": str(target / DESIGNS / f"{result.winner}.json"),
        "report": str(target / REPORT),
        "finalists": {
            entry.key: {
                "score": entry.score,
                "se": entry.se,
                "gain": entry.gain,
                "gain_se": entry.gain_se,
                "predicted": entry.predicted,
                **{
                    f"{key}_deg": asdict(entry.errors[reader]) for reader, key in ERROR_KEYS.items()
                },
            }
            for entry in result.finalists
        },
        "verdict": list(result.verdict),
        "evaluations": status.evaluations,
        "render_seconds": status.render_seconds,
        "seconds": status.seconds,
    }


def _print(stream: IO[str], result: OvernightResult, target: Path) -> None:
    from optimize.overnight.result import DESIGNS
    from optimize.overnight.run_directory import REPORT

    rows = [
        (
            entry.title,
            *(_pm(entry.errors[reader].value, entry.errors[reader].se, "°") for reader in READERS),
            f"{entry.score:.2f} ± {entry.se:.2f}",
            "" if entry.gain is None else f"{entry.gain:+.2f} ± {entry.gain_se:.2f}",
            f"{entry.predicted:.2f} ± {entry.predicted_reach:.2f}",
        )
        for entry in result.finalists
    ]
    print_table(
        stream,
        f"{result.scene.name}, {result.scene.hash}, reference",
        (
            "design",
            *(f"{reader} reader" for reader in READERS),
            "score S",
            "over baseline",
            "surrogate said",
        ),
        rows,
    )
    for sentence in result.verdict:
        stream.write(sentence + "\n")
    stream.write(f"Design: {target / DESIGNS / result.winner}.json\nReport: {target / REPORT}\n")


def _pm(value: float, se: float, unit: str) -> str:
    return f"{value:.2f}{unit} ± {se:.2f}{unit}"
