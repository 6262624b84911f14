"""Where the process ``tactilux`` begins: imports nothing before it knows what a Ctrl-C does."""

from __future__ import annotations

from collections.abc import Callable

from optimize.ui.process import run_process


def main() -> None:
    """Run the command line as this process."""
    run_process(_load)


def _load() -> Callable[[], None]:
    from hw.cli import main

    return main
