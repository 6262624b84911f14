"""What the commands say: results on stdout, everything else on stderr."""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import sys
import time
from collections.abc import Collection, Iterable, Iterator, Sequence
from typing import IO, TYPE_CHECKING

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

PATIENCE = 2.0  # seconds before a progress display appears
LOG_EVERY = 15.0  # seconds between progress lines where stderr is not a terminal


@contextlib.contextmanager
def reserved_stdout() -> Iterator[IO[str]]:
    """Keep stdout for the result alone: whatever any library prints goes to stderr.

    Works below Python, on the file descriptor, because Mitsuba and drivers print from C++.
    """
    sys.stdout.flush()
    kept = os.dup(1)
    try:
        os.dup2(2, 1)
        with (
            contextlib.redirect_stdout(sys.stderr),
            os.fdopen(os.dup(kept), "w", encoding="utf-8") as stream,
        ):
            yield stream
    finally:
        # What C code has printed may still wait in its buffer for the end of the process.
        ctypes.CDLL(None).fflush(None)
        os.dup2(kept, 1)
        os.close(kept)


def print_json(stream: IO[str], result: dict[str, object]) -> None:
    """Write one JSON object; NaN and infinity are errors, not extensions of the format."""
    stream.write(json.dumps(result, allow_nan=False) + "\n")


def print_table(
    stream: IO[str],
    title: str,
    headings: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    words: Collection[str] | None = None,
    width: int = 100,
    below: str = "",
) -> None:
    """Write a table with lines around its cells, ``width`` columns wide where no terminal says.

    Arguments:
        stream: where to.
        title: above the table.
        headings: of the columns.
        rows: a cell for each column.
        words: headings of columns that begin at the left, which is the first column unless told;
            numbers end at the right.
        width: columns of text where ``stream`` is no terminal.
        below: sentences under the table, broken into lines of that width.
    """
    from rich.console import Console
    from rich.table import Table

    table = Table(title=title, title_justify="left")
    for heading in headings:
        left = heading in (headings[:1] if words is None else words)
        table.add_column(heading, justify="left" if left else "right")
    for row in rows:
        table.add_row(*row)
    console = Console(file=stream, width=None if stream.isatty() else width)
    console.print(table)
    if below:
        console.print(below, highlight=False)


def note(text: str) -> None:
    """Write one line for the person at the terminal."""
    print(text, file=sys.stderr, flush=True)


class Meter:
    """Progress with the time left, on stderr, only for work that takes longer than 2 s.

    A bar on a terminal, a line every 15 s in a log. Use as a context manager and call with
    ``(done, total)``; ``eta`` in seconds replaces the estimate from elapsed time when known.
    """

    def __init__(self, title: str) -> None:
        self.title = title
        self._start = self._said = time.monotonic()
        self._bar: Progress | None = None
        self._task: TaskID | None = None

    def __enter__(self) -> Meter:
        """Start the clock."""
        self._start = self._said = time.monotonic()
        return self

    def __exit__(self, *_: object) -> None:
        """Take the bar away."""
        self.close()

    def close(self) -> None:
        """Take the bar away; calls after that start a new one."""
        if self._bar is not None:
            self._bar.stop()
            self._bar = None

    def __call__(self, done: float, total: float, eta: float | None = None) -> None:
        """Show that ``done`` of ``total`` units are finished."""
        now = time.monotonic()
        elapsed = now - self._start
        if elapsed < PATIENCE:
            return
        left = eta if eta is not None else elapsed * (total - done) / done if done > 0 else None
        remaining = "" if left is None else f"{clock(left)} left"
        if sys.stderr.isatty():
            self._draw(done, total, remaining)
        elif now - self._said >= LOG_EVERY:
            self._said = now
            note(f"{self.title}: {100 * done / total:.0f} %, {remaining}".rstrip(", "))

    def note(self, text: str) -> None:
        """Write a line that stays, above the bar if there is one."""
        if self._bar is None:
            note(text)
        else:
            self._bar.console.print(text, highlight=False)

    def _draw(self, done: float, total: float, remaining: str) -> None:
        if self._bar is None:
            from rich.console import Console
            from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn

            self._bar = Progress(
                TextColumn("{task.description}"),
                BarColumn(),
                TaskProgressColumn(),
                TextColumn("{task.fields[remaining]}"),
                console=Console(stderr=True),
                transient=True,
            )
            self._task = self._bar.add_task(self.title, total=total, remaining=remaining)
            self._bar.start()
        if self._task is not None:
            self._bar.update(self._task, completed=done, total=total, remaining=remaining)


class Stages:
    """One `Meter` after the other, for work in named stages; a context manager."""

    def __init__(self) -> None:
        self._name = ""
        self._meter: Meter | None = None

    def __enter__(self) -> Stages:
        """Begin without a stage."""
        return self

    def __exit__(self, *_: object) -> None:
        """Take the last bar away."""
        if self._meter is not None:
            self._meter.close()

    def __call__(self, stage: str, done: float, total: float, eta: float | None = None) -> None:
        """Show how far ``stage`` is; a new name begins a new bar. An ``eta`` of NaN is unknown."""
        if self._meter is None or stage != self._name:
            if self._meter is not None:
                self._meter.close()
            self._name, self._meter = stage, Meter(stage)
            note(f"{stage} ...")
        self._meter(done, total, None if eta is None or eta != eta else eta)


def clock(seconds: float) -> str:
    """Return ``h:mm:ss``, or ``m:ss`` below an hour."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"
