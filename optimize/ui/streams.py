"""Standard streams that fail no command: closed, on a full disk, or with a reader that has gone.

Who reads ``tactilux explore 2>&1 | head -1`` wants one line and the result in its folder; who
closes stdout wants no output. Both get what they want. A result that cannot be written is an error.
"""

from __future__ import annotations

import io
import os
import sys
from typing import IO, Any

from render.errors import TactiluxError


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


def _text(raw: io.FileIO, errors: str, *, lines: bool = False) -> io.TextIOWrapper:
    buffered = io.BufferedWriter(raw)
    lines = lines or raw.isatty()
    return io.TextIOWrapper(buffered, encoding="utf-8", errors=errors, line_buffering=lines)
