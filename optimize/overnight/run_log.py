"""What a night says while it works: a bar on a terminal, a log with time stamps, JSON lines."""

from __future__ import annotations

import json
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from types import FrameType
from typing import IO, Any

from optimize.ui.console import ProgressBar
from render.progress import Progress

LOG = "log.txt"
LOG_SECONDS = 60.0
"""Between lines of progress in the log."""
SHOW_SECONDS = 2.0
"""Between updates of everything else."""


class Stopped(KeyboardInterrupt):
    """A signal asked for the end; ``code`` is the exit code that says so."""

    def __init__(self, number: int) -> None:
        super().__init__()
        self.code = 128 + number


class RunLog:
    """Tells terminal, log and programs of the same events.

    Arguments:
        run: directory of ``log.txt``.
        lines: where JSON lines go, one object per event; None for nowhere.
        record: told of progress, for ``tactilux status``.
    """

    def __init__(self, run: Path, lines: IO[str] | None) -> None:
        """Open the log."""
        self._log = (run / LOG).open("a", encoding="utf-8")
        self._lines = lines
        self._bar, self._stage = ProgressBar(), ""
        self._shown = self._logged = 0.0
        self.record: Callable[[str, float, float, float | None], None] = lambda *_: None

    def close(self) -> None:
        """Take the bar away and close the log."""
        self._bar.close()
        self._log.close()

    def note(self, text: str) -> None:
        """Say one line that stays."""
        self._bar.note(text)
        self._write(text)
        self._emit({"event": "note", "text": text})

    def stage(self, name: str) -> None:
        """Begin a stage."""
        if name != self._stage:
            self._bar.close()
            self._stage, self._bar = name, ProgressBar(name)
            self._shown = self._logged = 0.0
            self._write(f"{name} ...")
            self._emit({"event": "stage", "stage": name})

    def progress(self, at: Progress) -> None:
        """Show how far the stage is; the time left is that of the whole night."""
        now = time.monotonic()
        if now - self._shown < SHOW_SECONDS:
            return
        self._shown = now
        self._bar(replace(at, stage=""))
        self.record(self._stage, at.done, at.total, at.eta_seconds)
        self._emit(
            {"event": "progress", "stage": self._stage, "done": at.done, "total": at.total,
             "eta_seconds": at.eta_seconds}
        )  # fmt: skip
        if now - self._logged >= LOG_SECONDS:
            self._logged = now
            left = "" if at.eta_seconds is None else f", {at.eta_seconds:.0f} s left in all"
            self._write(f"{self._stage}: {100 * at.done / max(at.total, 1e-9):.0f} %{left}")

    def _write(self, text: str) -> None:
        stamp = datetime.now().astimezone().isoformat(timespec="seconds")
        self._log.write(f"{stamp} {text}\n")
        self._log.flush()

    def _emit(self, event: dict[str, Any]) -> None:
        if self._lines is not None:
            self._lines.write(json.dumps(event, allow_nan=False) + "\n")
            self._lines.flush()


class Signals:
    """SIGINT and SIGTERM end the night: at once, or where a render can keep its state.

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
