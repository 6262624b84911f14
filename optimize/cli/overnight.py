"""``tactilux overnight``: in the evening a scene, in the morning a verified design."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import IO

from optimize.overnight.job import OvernightConfig, check_directory, overnight
from optimize.overnight.report import REPORT
from optimize.overnight.result import DESIGNS, OvernightResult
from optimize.overnight.run_log import Stopped
from optimize.overnight.status import status_of
from optimize.overnight.workers import LocalWorker, Workers
from optimize.ui.console import note, print_json, reserved_stdout
from render.reference.llvm import ensure_llvm
from render.scene.schema import load_scene


def run(
    scene_name: str,
    *,
    out: Path | None,
    hours: float | None,
    samples: int | None,
    workers: int | None,
    dask: str | None,
    seed: int,
    as_json: bool,
    json_lines: bool,
) -> None:
    """Do the job, print its outcome, and say where everything is."""
    with reserved_stdout() as stream:
        scene = load_scene(scene_name)
        target = out or Path("runs") / f"{scene.name}-overnight"
        check_directory(target)
        if dask is None:
            ensure_llvm()

        def make_workers() -> Workers:
            if workers is None and dask is None:
                return LocalWorker()
            from optimize.overnight.dask_workers import DaskWorkers

            return DaskWorkers(workers=workers, address=dask)

        note(f"Everything is kept in {target}; interrupted, the same command goes on from there")
        config = OvernightConfig(None if samples else hours or 8.0, samples, seed)
        try:
            result = overnight(
                scene_name,
                target,
                config,
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
    status = status_of(target)
    return {
        "scene": result.scene.name,
        "scene_hash": result.scene.hash,
        "level": "reference",
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
            }
            for entry in result.finalists
        },
        "verdict": list(result.verdict),
        "evaluations": status.evaluations,
        "render_seconds": status.render_seconds,
        "seconds": status.seconds,
    }


def _print(stream: IO[str], result: OvernightResult, target: Path) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(
        title=f"{result.scene.name}, {result.scene.hash}, level reference", title_justify="left"
    )
    table.add_column("design")
    for heading in ("score S", "over baseline", "surrogate said"):
        table.add_column(heading, justify="right")
    for entry in result.finalists:
        gain = "" if entry.gain is None else f"{entry.gain:+.2f} ± {entry.gain_se:.2f}"
        table.add_row(
            entry.title,
            f"{entry.score:.2f} ± {entry.se:.2f}",
            gain,
            f"{entry.predicted:.2f} ± {entry.predicted_reach:.2f}",
        )
    Console(file=stream, width=None if stream.isatty() else 100).print(table)
    for sentence in result.verdict:
        stream.write(sentence + "\n")
    stream.write(f"Design: {target / DESIGNS / result.winner}.json\nReport: {target / REPORT}\n")
