"""``tactilux status``: how far a run is, also while it works."""

from __future__ import annotations

import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import IO, TYPE_CHECKING, Annotated

from typer import Argument, BadParameter, Option

from optimize.cli.options import Json
from optimize.ui.console import counted, duration, print_json, print_table, reserved_stdout

if TYPE_CHECKING:
    from optimize.overnight.scaling import Scaling

_WORDS = {
    "running": "works now",
    "finished": "is finished",
    "stopped": "was stopped; the same command goes on",
    "lost": "was killed; the same command goes on",
}


def run(
    directory: Annotated[Path, Argument(metavar="run", help="Directory of an overnight run.")],
    scaling: Annotated[
        bool, Option("--scaling", help="Say what 2, 8 and 64 workers would do.")
    ] = False,
    hours: Annotated[
        float | None,
        Option(min=0.01, help="With --scaling: for a night of so many hours instead."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Say how far an overnight run is, also while it works."""
    if hours is not None and not scaling:
        raise BadParameter("--hours goes with --scaling")
    from optimize.overnight.status import status_of

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
            f"Renders: {found.evaluations} in {duration(found.render_seconds)} of rendering\n"
            f"Worked: {duration(found.seconds)} in {counted(found.attempts, 'attempt')}\n"
        )
        if found.eta_seconds is not None:
            stream.write(f"Left: {duration(found.eta_seconds)}\n")
        if more is not None:
            _print_scaling(stream, more)


def _scaling(directory: Path, hours: float | None) -> Scaling:
    """Return what the finished run has kept, or a simulation by what there is so far."""
    from optimize.overnight.scaling import load_scaling, scaling_of

    kept = load_scaling(directory) if hours is None else None
    return kept or scaling_of(directory, Path(tempfile.gettempdir()), hours)


def _print_scaling(stream: IO[str], scaling: Scaling) -> None:
    from optimize.overnight.scaling import scaling_rows, scaling_words

    headings = ("workers", "the night takes", "times as fast", "renders in the same time")
    rows, below = scaling_rows(scaling), scaling_words(scaling)
    print_table(stream, "More workers", headings, rows, words=(), below=below)
