"""What a night says while it works: a bar on a terminal, a log with time stamps, JSON lines."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import IO, Any

from optimize.overnight.run_directory import LOG
from optimize.ui.console import ProgressBar
from optimize.ui.terminal_text import printable
from render.progress import Progress

LOG_SECONDS = 60.0
"""Between lines of progress in the log."""
SHOW_SECONDS = 2.0
"""Between updates of everything else."""


class RunLog:
    """Tells terminal, log and programs of the same events.

    ``lines`` get JSON, one object per event; ``record`` is told of progress, for ``tactilux
    status``.
    """

    def __init__(self, run: Path, lines: IO[str] | None) -> None:
        self._log = (run / LOG).open("a", encoding="utf-8")
        self._lines = lines
        self._bar, self._stage = ProgressBar(), ""
        self._shown = self._logged = 0.0
        self.record: Callable[[str, Progress], None] = lambda *_: None

    def close(self) -> None:
        """Take the bar away and close the log."""
        self._bar.close()
        self._log.close()

    def note(self, text: str) -> None:
        """Say one line that stays."""
        self._bar.note(text)
        self.keep(text)

    def keep(self, text: str) -> None:
        """Keep one line in the log, and for programs; a terminal is told it with the result."""
        self._write(text, event="note", text=text)

    def stage(self, name: str) -> None:
        """Begin a stage."""
        if name != self._stage:
            self._bar.close()
            self._stage, self._bar = name, ProgressBar(name)
            self._shown = self._logged = 0.0
            self._write(f"{name} ...", event="stage", stage=name)

    def progress(self, at: Progress) -> None:
        """Show how far the stage is; the time left is that of the whole night."""
        now, left = time.monotonic(), at.eta_seconds
        if now - self._shown < SHOW_SECONDS:
            return
        self._shown = now
        self._bar(replace(at, stage=""))
        self.record(self._stage, at)
        text = ""
        if now - self._logged >= LOG_SECONDS:
            self._logged = now
            text = f"{self._stage}: {100 * at.done / max(at.total, 1e-9):.0f} %"
            text += "" if left is None else f", {left:.0f} s left in all"
        state = {"done": at.done, "total": at.total, "eta_seconds": left}
        self._write(text, event="progress", stage=self._stage, **state)

    def _write(self, line: str, **event: Any) -> None:
        """Write ``line``, if any, to the log, and the event for programs."""
        if line:
            stamp = datetime.now().astimezone().isoformat(timespec="seconds")
            self._log.write(f"{stamp} {printable(line)}\n")
            self._log.flush()
        if self._lines is not None:
            self._lines.write(json.dumps(event, allow_nan=False) + "\n")
            self._lines.flush()
