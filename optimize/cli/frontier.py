"""``tactilux frontier``: what every level of the ladder costs, and how wrong it is."""

from __future__ import annotations

import json
from pathlib import Path
from typing import IO

from optimize.design.models import open_model
from optimize.frontier.frontier import Frontier, measure
from optimize.frontier.plan import check_folder
from optimize.frontier.plot import frontier_png
from optimize.ui.console import Stages, note, print_json, reserved_stdout
from optimize.ui.output import write_result
from render.reference.llvm import ensure_llvm
from render.scene.schema import load_scene
from render.transport import load_table

RESULT, PLOT = "frontier.json", "frontier.png"


def run(
    scene_name: str,
    *,
    out: Path | None,
    model: Path | None,
    table: Path | None,
    designs: int,
    minutes: float,
    samples: int | None,
    seed: int,
    as_json: bool,
) -> None:
    """Measure, write plot and JSON into the run directory, and print the table."""
    with reserved_stdout() as stream:
        scene = load_scene(scene_name)
        folder = out or Path("runs") / f"{scene.name}-frontier"
        check_folder(folder)
        checker = open_model(scene, model)
        trained = Path("models") / f"{scene.name}-training" / "reference.npz"
        given = table or (trained if trained.is_file() else None)
        known = None if given is None else load_table(given)
        ensure_llvm()
        note(
            f"Fits and transport table: {given or 'no table of reference renders, so one is made'}"
            f"; interrupted, the same command goes on from {folder}"
        )
        with Stages() as report:
            found = measure(
                scene,
                checker,
                folder,
                count=designs,
                seed=seed,
                minutes=minutes,
                samples=samples,
                table=known,
                report=report,
            )
        result = found.to_json() | {"plot": str(folder / PLOT)}
        text = json.dumps(result, indent=2, allow_nan=False) + "\n"
        write_result(folder / PLOT, frontier_png(found))
        write_result(folder / RESULT, text.encode())
        if as_json:
            print_json(stream, result)
        else:
            _print(stream, found, folder)


def _print(stream: IO[str], found: Frontier, folder: Path) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(
        title=f"{found.scene.name}: {found.plan.designs} random held-out designs",
        title_justify="left",
    )
    table.add_column("level")
    for heading in ("s per design", "color error", "95 %", "rms, no noise", "S off by", "tau"):
        table.add_column(heading, justify="right")
    for row in (*found.rows, found.noise):
        low, high = row.kendall_tau_interval
        table.add_row(
            row.level,
            f"{row.seconds_per_design:.2g}",
            f"{row.facet_error_median:.1%}",
            f"{row.facet_error_p95:.1%}",
            f"{row.facet_error_true:.1%}",
            f"{row.score_error:.2f}",
            f"{row.kendall_tau:.2f} ({low:.2f} to {high:.2f})",
        )
    Console(file=stream, width=None if stream.isatty() else 110).print(table)
    reference = found.reference
    stream.write(
        f"Reference: bidirectional, MIS, {reference.samples} samples per cell, "
        f"{reference.seconds:.0f} s; "
        f"its scores are known to {found.to_json()['reference']['score_se_median']:.2f} counts.\n"  # type: ignore[index]
        f"The model's {found.nominal:.0%} intervals held {found.coverage.counts:.1%} of facet "
        f"colors and {found.coverage.score:.1%} of scores.\n"
        f"One design alone takes {found.seconds_alone:.0f} s at {found.plan.short[-1]} samples.\n"
        f"Plot: {folder / PLOT}\nJSON: {folder / RESULT}\n"
    )
