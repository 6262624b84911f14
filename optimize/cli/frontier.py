"""``tactilux frontier``: what every level of the ladder costs, and how wrong it is."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import IO, TYPE_CHECKING, Annotated

from typer import Option

from optimize.cli.options import Json, ModelFolder, SceneName, Seed
from optimize.ui.console import ProgressBar, note, print_json, print_table, reserved_stdout

if TYPE_CHECKING:
    from optimize.frontier import Frontier

RESULT, PLOT = "frontier.json", "frontier.png"


def run(
    scene_name: SceneName = "finger20",
    out: Annotated[
        Path | None, Option(help="Run directory (default: runs/<scene>-frontier).")
    ] = None,
    model: ModelFolder = None,
    table: Annotated[
        Path | None,
        Option(
            help="Reference table to fit to (default: models/<scene>-training/reference.npz, "
            "or a new render)."
        ),
    ] = None,
    designs: Annotated[int, Option(min=2, help="Random held-out designs.")] = 30,
    minutes: Annotated[float, Option(min=3.0, help="Time for everything together.")] = 30.0,
    samples: Annotated[
        int | None,
        Option(min=32, help="Samples per cell of the reference: the same work on any machine."),
    ] = None,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Measure what every level costs and how wrong it is."""
    began = time.monotonic()
    from optimize.frontier import PLAN, measure_frontier
    from optimize.frontier.plot import frontier_png
    from optimize.scoring import open_model
    from optimize.ui.output import check_target, write_result
    from render.reference import TimeBudget, ensure_llvm
    from render.scene import load_scene
    from render.transport import load_table

    with reserved_stdout() as stream:
        scene = load_scene(scene_name)
        folder = out or Path("runs") / f"{scene.name}-frontier"
        check_target(folder, PLAN)
        checker = open_model(scene, model)
        trained = Path("models") / f"{scene.name}-training" / "reference.npz"
        given = table or (trained if trained.is_file() else None)
        known = None if given is None else load_table(given)
        ensure_llvm()
        note(
            f"Fits and transport table: {given or 'no table of reference renders, so one is made'}"
            f"; interrupted, the same command goes on from {folder}"
        )
        with ProgressBar(announce=True) as report:
            found = measure_frontier(
                scene,
                checker,
                folder,
                count=designs,
                seed=seed,
                budget=TimeBudget.of_minutes(minutes, began),
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
    rows = []
    for row in (*found.rows, found.noise):
        low, high = row.kendall_tau_interval
        rows.append(
            (
                row.level,
                f"{row.seconds_per_design:.2g}",
                f"{row.facet_median:.1%}",
                f"{row.facet_p95:.1%}",
                f"{row.facet_rms_true:.1%}",
                f"{row.score_median:.2f}",
                f"{row.kendall_tau:.2f} ({low:.2f} to {high:.2f})",
            )
        )
    print_table(
        stream,
        f"{found.reference.designs.scene.name}: {found.plan.designs} random held-out designs",
        ("level", "s per design", "color error", "95 %", "rms, no noise", "S off by", "tau"),
        rows,
        width=110,
    )
    reference = found.reference
    stream.write(
        f"Reference: bidirectional, MIS, {found.plan.samples} samples per cell, "
        f"{reference.seconds:.0f} s; "
        f"its scores are known to {reference.score_se:.2f} counts.\n"
        f"The model's {found.nominal:.0%} intervals held {found.coverage.counts:.1%} of facet "
        f"colors and {found.coverage.score:.1%} of scores.\n"
        f"One design alone takes {found.seconds_alone:.0f} s at {found.plan.short[-1]} samples.\n"
        f"Plot: {folder / PLOT}\nJSON: {folder / RESULT}\n"
    )
