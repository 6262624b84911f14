"""``tactilux status``: how far a run is, also while it works."""

from __future__ import annotations

from pathlib import Path

from optimize.console import clock, print_json, reserved_stdout
from optimize.overnight.status import status_of

_WORDS = {
    "running": "works now",
    "finished": "is finished",
    "stopped": "was stopped; the same command goes on",
    "lost": "was killed; the same command goes on",
}


def run(directory: Path, *, as_json: bool) -> None:
    """Print progress, the best design so far and the time left."""
    with reserved_stdout() as stream:
        found = status_of(directory)
        if as_json:
            print_json(stream, found.to_json())
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
