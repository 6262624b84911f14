"""The process that runs a command: signals, streams and exit codes, whatever happens when.

Python's own answer to Ctrl-C depends on the instant: a traceback while modules are imported or the
interpreter ends, nothing at all while a destructor runs or a library tries an import. Here it is
the same at every instant.

Standard streams fail no command: closed, on a full disk, or with a reader that has gone. Who reads
``tactilux explore 2>&1 | head -1`` wants one line and the result in its folder; who closes stdout
wants no output. Both get what they want. A result that cannot be written is an error.
"""

from __future__ import annotations

import io
import os
import signal
import sys
import threading
import traceback
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType, TracebackType
from typing import IO, TYPE_CHECKING, Any

from optimize.ui.terminal_text import printable
from render.errors import TactiluxError

if TYPE_CHECKING:
    from sys import UnraisableHookArgs

EXIT_CODES = "Exit codes: 0 done, 1 check found a fault, 2 bad input or no room, 130 interrupted, 143 ended by SIGTERM or SIGHUP."  # noqa: E501
RETRY_SECONDS = 0.01


class Terminated(KeyboardInterrupt):
    """SIGTERM or SIGHUP asked for the end."""


def run_process(load: Callable[[], Callable[[], None]]) -> None:
    """Run what ``load`` imports and returns, as all that this process does.

    Before and after it, when there is nothing to tidy up, SIGINT, SIGTERM and SIGHUP end the
    process at once. Inside they raise KeyboardInterrupt and `Terminated`. Signals that whoever
    started the process ignores, as ``nohup`` does, stay ignored.
    """
    numbers = [
        number
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
        if signal.getsignal(number) != signal.SIG_IGN
    ]
    _by_default(numbers)
    open_standard_streams()
    sys.unraisablehook, sys.excepthook = _unraisable, _uncaught
    warnings.showwarning = _warn  # type: ignore[assignment]
    command = load()
    try:
        for number in numbers:
            signal.signal(number, _end)
        command()
    except KeyboardInterrupt as error:
        # While the command said its last words.
        sys.exit(interruption(error))
    finally:
        _by_default(numbers)


def interruption(error: BaseException | None) -> int | None:
    """Return the exit code of the signal behind ``error``, None where there is none.

    Libraries wrap KeyboardInterrupt: Dr.Jit says that a loop "encountered an exception".
    """
    codes = [143 if isinstance(cause, Terminated) else 130
             for cause in causes(error) if isinstance(cause, KeyboardInterrupt)]  # fmt: skip
    return max(codes, default=None)


def causes(error: BaseException | None) -> Iterator[BaseException]:
    """Yield ``error``, what it was raised from or while handling, and so on."""
    known: set[int] = set()
    while error is not None and id(error) not in known:
        known.add(id(error))
        yield error
        error = error.__cause__ or error.__context__


def _by_default(numbers: Any) -> None:
    for number in numbers:
        signal.signal(number, signal.SIG_DFL)


def _end(number: int, frame: FrameType | None) -> None:
    if not _put_off(number, frame):
        raise KeyboardInterrupt if number == signal.SIGINT else Terminated


def _put_off(number: int, frame: FrameType | None) -> bool:
    """Send a signal again in a moment where it interrupts an import, and return whether it does.

    Libraries that try imports keep to themselves what these raise (trimesh catches all there is),
    and the work would go on.
    """
    while frame is not None and not frame.f_code.co_filename.startswith("<frozen importlib"):
        frame = frame.f_back
    if frame is not None:
        _send_again(number)
    return frame is not None


def _send_again(number: int) -> None:
    # To the main thread, which alone answers: what it waits for ends then.
    target = threading.main_thread().ident
    threading.Timer(RETRY_SECONDS, signal.pthread_kill, [target, number]).start()


def _unraisable(about: UnraisableHookArgs) -> None:
    """Raise a signal again that came while a destructor ran; what streams say there is known."""
    code = interruption(about.exc_value)
    if code is not None:
        _send_again(signal.SIGINT if code == 130 else signal.SIGTERM)
    elif not isinstance(about.exc_value, OSError):
        sys.__unraisablehook__(about)


def _uncaught(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Print the traceback of a mistake of the program; a signal needs none."""
    if interruption(error) is None:
        traceback.print_exception(kind, error, trace)


def _warn(message: Warning | str, *_: Any) -> None:
    """Say a warning without the line of source that it comes from."""
    print(f"tactilux: {message}", file=sys.stderr)


class Stopped(KeyboardInterrupt):
    """A signal asked for the end; ``code`` is the exit code that says so."""

    def __init__(self, number: int) -> None:
        super().__init__()
        self.code = 128 + number


class Signals:
    """SIGINT and SIGTERM end the work: at once, or where what is under way can keep its state.

    A second signal does not wait.
    """

    def __init__(self) -> None:
        self._asked = 0
        self._patient = False

    @contextmanager
    def caught(self) -> Iterator[None]:
        """Handle both signals inside the block."""
        numbers = (signal.SIGINT, signal.SIGTERM)
        before = {number: signal.signal(number, self._handle) for number in numbers}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    @contextmanager
    def patient(self) -> Iterator[Callable[[], None]]:
        """Hold a first signal back inside the block; what is given raises it when called."""
        self._patient = True
        try:
            yield self._raise_if_asked
        finally:
            self._patient = False
        self._raise_if_asked()

    def _raise_if_asked(self) -> None:
        if self._asked:
            raise Stopped(self._asked)

    def _handle(self, number: int, frame: FrameType | None) -> None:
        if _put_off(number, frame):
            return
        first, self._asked = not self._asked, number
        if not (first and self._patient):
            raise Stopped(number)


class OutputError(TactiluxError):
    """A place that results cannot, or must not, be written to."""


def open_standard_streams() -> None:
    """Open what is closed, and let ``sys.stdout`` and ``sys.stderr`` fail as this module says.

    Streams that somebody else has put there, as tests do, stay.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            # The lowest free number, so this one: else the next file that is opened would be it.
            os.open(os.devnull, os.O_RDWR)
    if sys.stdout is sys.__stdout__:
        sys.stdout = _text(_Results(1, "w", closefd=False), "surrogateescape")
    if sys.stderr is sys.__stderr__:
        sys.stderr = _text(_Notes(2, "w", closefd=False), "backslashreplace", lines=True)


def result_stream(descriptor: int) -> IO[str]:
    """Return the stream of results on ``descriptor``, which closes with it.

    Writing or closing it raises OutputError where the result has no room.
    """
    return _text(_Results(descriptor, "w"), "surrogateescape")


class _Results(io.FileIO):
    """Results: nobody who reads them is no error, a place that does not take them is one."""

    def write(self, content: Any, /) -> int:
        try:
            return super().write(content)
        except BrokenPipeError:
            return _discard(self, content)
        except OSError as error:
            # What waits in buffers is lost: their last flush, at the end of the process, is silent.
            _discard(self, content)
            raise OutputError(
                f"the standard output cannot be written ({error.strerror}): send it to a place "
                "that takes it",
                field="stdout",
            ) from None


class _Notes(io.FileIO):
    """What is said by the way: work goes on where it cannot be said."""

    def write(self, content: Any, /) -> int:
        try:
            return super().write(content)
        except OSError:
            return _discard(self, content)


def _discard(stream: io.FileIO, content: Any) -> int:
    """Point ``stream`` to nowhere, for all who write to its descriptor, also from C."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, stream.fileno())
    os.close(nowhere)
    return memoryview(content).nbytes


class _Printed(io.TextIOWrapper):
    """Text that no stranger steers a terminal with; see `optimize.ui.terminal_text`."""

    def write(self, text: str, /) -> int:
        super().write(printable(text))
        return len(text)

    def write_steered(self, text: str, /) -> int:
        """Write ``text`` as it is."""
        return super().write(text)


def _text(raw: io.FileIO, errors: str, *, lines: bool = False) -> _Printed:
    buffered = io.BufferedWriter(raw)
    lines = lines or raw.isatty()
    return _Printed(buffered, encoding="utf-8", errors=errors, line_buffering=lines)
