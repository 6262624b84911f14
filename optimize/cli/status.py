"""``tactilux status``: how far a run is, also while it works."""

from __future__ import annotations

import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import IO

from optimize.overnight.scaling import (
    Scaling,
    load_scaling,
    scaling_of,
    scaling_rows,
    scaling_words,
)
from optimize.overnight.status import status_of
from optimize.ui.console import clock, print_json, reserved_stdout

_WORDS = {
    "running": "works now",
    "finished": "is finished",
    "stopped": "was stopped; the same command goes on",
    "lost": "was killed; the same command goes on",
}


def run(directory: Path, *, scaling: bool, hours: float | None, as_json: bool) -> None:
    """Print progress, the best design so far and the time left.

    ``scaling``: also what more workers would do, for ``hours`` instead of the run itself.
    """
    with reserved_stdout() as stream:
        found = status_of(directory)
        more = _scaling(directory, hours) if scaling else None
        if as_json:
            extra = {} if more is None else {"scaling": asdict(more)}
            print_json(stream, found.to_json() | extra)
            return
        by = f" ({found.holder})" if found.holder else ""
        stream.write(f"{directory} {_WORDS[found.state]}{by}\n")
        if found.stage and found.state != "finished":
            stream.write(f"Stage: {found.stage}, {100 * found.share:.0f} %\n")
        if found.best is not None:
            low, high = found.best["interval"]
            stream.write(
                f"Best so far: {found.best['score']:.2f} ({low:.2f} to {high:.2f}), level "
                f"{found.best['level']}, {found.best['design']}\n"
            )
        stream.write(
            f"Renders: {found.evaluations} in {clock(found.render_seconds)} of rendering\n"
            f"Worked: {clock(found.seconds)} in {found.attempts} attempts\n"
        )
        if found.eta_seconds is not None:
            stream.write(f"Left: {clock(found.eta_seconds)}\n")
        if more is not None:
            _print_scaling(stream, more)


def _scaling(directory: Path, hours: float | None) -> Scaling:
    """Return what the finished run has kept, or a simulation by what there is so far."""
    kept = load_scaling(directory) if hours is None else None
    return kept or scaling_of(directory, Path(tempfile.gettempdir()), hours)


def _print_scaling(stream: IO[str], scaling: Scaling) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(title="More workers", title_justify="left")
    for heading in ("workers", "the night takes", "times as fast", "renders in the same time"):
        table.add_column(heading, justify="right")
    for row in scaling_rows(scaling):
        table.add_row(*row)
    console = Console(file=stream, width=None if stream.isatty() else 100)
    console.print(table)
    console.print(scaling_words(scaling), highlight=False)
