"""SIGINT and SIGTERM as an exception that says which it was, held back where work can be kept."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType


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
        first, self._asked = not self._asked, number
        if not (first and self._patient):
            raise Stopped(number)
