"""Where the process ``tactilux`` begins: it imports nothing before it knows what a Ctrl-C does."""

from __future__ import annotations

# Built in: even `signal` imports what takes milliseconds, in which a Ctrl-C would be a traceback.
import _signal  # type: ignore[import-not-found]
from collections.abc import Callable


def main() -> None:
    """Run the command line as this process."""
    if _signal.getsignal(_signal.SIGINT) is _signal.default_int_handler:
        _signal.signal(_signal.SIGINT, _signal.SIG_DFL)
    from optimize.ui.process import run_process

    run_process(_load)


def _load() -> Callable[[], None]:
    from hw.cli import main

    return main
