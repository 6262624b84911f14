"""The process that runs a command: signals, streams and exit codes, whatever happens when.

Python's own answer to Ctrl-C depends on the instant: a traceback while modules are imported or the
interpreter ends, nothing at all while a destructor runs. Here it is the same at every instant.
"""

from __future__ import annotations

import signal
import sys
import threading
import traceback
import warnings
from collections.abc import Callable, Iterator
from types import FrameType, TracebackType
from typing import TYPE_CHECKING, Any

from optimize.ui.streams import open_standard_streams

if TYPE_CHECKING:
    from sys import UnraisableHookArgs

EXIT_CODES = "Exit codes: 0 done, 1 check found a fault, 2 bad input or no room, 130 interrupted, 143 ended by SIGTERM."  # noqa: E501
RETRY_SECONDS = 0.01


class Terminated(KeyboardInterrupt):
    """SIGTERM asked for the end."""


def run_process(load: Callable[[], Callable[[], None]]) -> None:
    """Run what ``load`` imports and returns, as all that this process does.

    Before and after it, when there is nothing to tidy up, SIGINT and SIGTERM end the process at
    once. Inside they raise KeyboardInterrupt and `Terminated`. Signals that whoever started the
    process ignores, as ``nohup`` does, stay ignored.
    """
    handlers: dict[int, Callable[[int, FrameType | None], Any]] = {
        signal.SIGINT: signal.default_int_handler,
        signal.SIGTERM: _terminate,
    }
    handlers = {
        number: handler
        for number, handler in handlers.items()
        if signal.getsignal(number) != signal.SIG_IGN
    }
    _by_default(handlers)
    open_standard_streams()
    sys.unraisablehook, sys.excepthook = _unraisable, _uncaught
    warnings.showwarning = _warn  # type: ignore[assignment]
    command = load()
    try:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        command()
    finally:
        _by_default(handlers)


def interruption(error: BaseException | None) -> int | None:
    """Return the exit code of the signal behind ``error``, None where there is none.

    Libraries wrap KeyboardInterrupt: Dr.Jit says that a loop "encountered an exception".
    """
    codes = [143 if isinstance(cause, Terminated) else 130
             for cause in _causes(error) if isinstance(cause, KeyboardInterrupt)]  # fmt: skip
    return max(codes, default=None)


def _causes(error: BaseException | None) -> Iterator[BaseException]:
    """Yield ``error``, what it was raised from or while handling, and so on."""
    known: set[int] = set()
    while error is not None and id(error) not in known:
        known.add(id(error))
        yield error
        error = error.__cause__ or error.__context__


def _by_default(numbers: Any) -> None:
    for number in numbers:
        signal.signal(number, signal.SIG_DFL)


def _terminate(number: int, frame: FrameType | None) -> None:
    raise Terminated


def _unraisable(about: UnraisableHookArgs) -> None:
    """Raise a signal again that came while a destructor ran; what streams say there is known."""
    code = interruption(about.exc_value)
    if code is not None:
        number = signal.SIGINT if code == 130 else signal.SIGTERM
        threading.Timer(RETRY_SECONDS, signal.raise_signal, [number]).start()
    elif not isinstance(about.exc_value, OSError):
        sys.__unraisablehook__(about)


def _uncaught(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Print the traceback of a mistake of the program; a signal needs none."""
    if interruption(error) is None:
        traceback.print_exception(kind, error, trace)


def _warn(message: Warning | str, *_: Any) -> None:
    """Say a warning without the line of source that it comes from."""
    print(f"tactilux: {message}", file=sys.stderr)
