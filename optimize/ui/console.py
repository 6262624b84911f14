"""What the commands say: results on stdout, everything else on stderr."""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import sys
import time
from collections.abc import Collection, Iterable, Iterator, Sequence
from typing import IO, TYPE_CHECKING, Literal, cast

from optimize.ui.process import result_stream
from optimize.ui.terminal_text import Steered, one_line, printable
from render.errors import TactiluxError
from render.progress import OnProgress, Progress

if TYPE_CHECKING:
    import rich.progress

PATIENCE = 2.0  # seconds before a progress display appears
LOG_EVERY = 15.0  # seconds between progress lines where stderr is not a terminal


@contextlib.contextmanager
def reserved_stdout() -> Iterator[IO[str]]:
    """Keep stdout for the result alone: whatever any library prints goes to stderr.

    Works below Python, on the file descriptor, because Mitsuba and drivers print from C++.
    Matplotlib, which does without a place for its cache, need not say so in lines of its own.
    """
    import logging  # --help does without it

    logging.getLogger("matplotlib").setLevel(logging.ERROR)
    sys.stdout.flush()
    kept = os.dup(1)
    try:
        os.dup2(2, 1)
        with (
            contextlib.redirect_stdout(sys.stderr),
            result_stream(os.dup(kept)) as stream,
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

    ``words`` are headings of columns that begin at the left, the first one unless told; numbers end
    at the right. Sentences ``below`` are broken into lines of that width.
    """
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    # Plain text: what looks like rich's markup in it is none.
    table = Table(title=Text(one_line(title)) if title else None, title_justify="left")
    for heading in headings:
        left = heading in (headings[:1] if words is None else words)
        justify: Literal["left", "right"] = "left" if left else "right"
        table.add_column(Text(one_line(heading)), justify=justify, overflow="fold")
    for row in rows:
        table.add_row(*(Text(one_line(cell)) for cell in row))
    console = Console(file=cast(IO[str], Steered(stream)), width=None if stream.isatty() else width)
    console.print(table)
    if below:
        console.print(printable(below), highlight=False, markup=False)


def note(text: str) -> None:
    """Write one line for the person at the terminal."""
    print(one_line(text), file=sys.stderr, flush=True)


class ProgressBar:
    """Shows on stderr how far work is that takes longer than 2 s, and how long it will take.

    A bar on a terminal, a line every 15 s in a log. A context manager that is called with
    `Progress`; where that knows no time left, the time since the stage began tells.

    The stage follows the ``title``; ``announce`` writes a line where one begins.
    """

    def __init__(self, title: str = "", *, announce: bool = False) -> None:
        self.title, self.announce = title, announce
        self._stage = ""
        self._start = self._stage_start = self._said = time.monotonic()
        self._bar: rich.progress.Progress | None = None

    def __enter__(self) -> ProgressBar:
        """Begin to count the time."""
        self._start = self._stage_start = self._said = time.monotonic()
        return self

    def __exit__(self, *_: object) -> None:
        """Take the bar away."""
        self.close()

    def close(self) -> None:
        """Take the bar away; calls after that start a new one."""
        if self._bar is not None:
            self._bar.stop()
            self._bar = None

    def __call__(self, at: Progress) -> None:
        """Show how far the work is."""
        if at.note:
            self.note(at.note)
        if not at.total:
            return
        now = time.monotonic()
        title = f"{self.title} {at.stage}".strip()
        title = title[:1].upper() + title[1:]
        if at.stage != self._stage:
            self._stage, self._stage_start = at.stage, now
            if self.announce:
                self.note(f"{title} ...")
        if now - self._start < PATIENCE:
            return
        left, elapsed = at.eta_seconds, now - self._stage_start
        if left is None and at.done > 0:
            left = elapsed * (at.total - at.done) / at.done
        remaining = "" if left is None else f"{duration(left)} left"
        if sys.stderr.isatty():
            self._draw(title, at, remaining)
        elif now - self._said >= LOG_EVERY:
            self._said = now
            note(f"{title}: {100 * at.done / at.total:.0f} %, {remaining}".rstrip(", "))

    def note(self, text: str) -> None:
        """Write a line that stays, above the bar if there is one."""
        if self._bar is None:
            note(text)
        else:
            self._bar.console.print(one_line(text), highlight=False, markup=False)

    def _draw(self, title: str, at: Progress, remaining: str) -> None:
        if self._bar is None:
            from rich.console import Console
            from rich.progress import BarColumn, TaskProgressColumn, TextColumn
            from rich.progress import Progress as RichProgress

            self._bar = RichProgress(
                TextColumn("{task.description}", markup=False),
                BarColumn(),
                TaskProgressColumn(),
                TextColumn("{task.fields[remaining]}"),
                console=Console(file=cast(IO[str], Steered(sys.stderr))),
                transient=True,
            )
            self._bar.add_task(one_line(title), total=at.total, remaining=remaining)
            self._bar.start()
        self._bar.update(
            self._bar.task_ids[0],
            description=one_line(title),
            completed=at.done,
            total=at.total,
            remaining=remaining,
        )


@contextlib.contextmanager
def shown_progress(progress: OnProgress | bool | None, title: str) -> Iterator[OnProgress | None]:
    """Give what long work tells: a bar on stderr for True, nobody for False or None, or a function.

    Raises:
        TactiluxError: ``progress`` is something else.
    """
    if progress is True:
        with ProgressBar(title) as bar:
            yield bar
    elif progress is False:
        yield None
    else:
        from render.arguments import as_callback  # --help does without numpy

        yield as_callback(progress, "progress", TactiluxError)


def counted(count: int, one: str, many: str = "") -> str:
    """Return a number with its noun, ``1 seed`` or ``2 seeds``.

    >>> counted(1, "seed"), counted(1200, "match", "matches")
    ('1 seed', '1,200 matches')
    """
    return f"{count:,} {one if count == 1 else many or one + 's'}"


def duration(seconds: float) -> str:
    """Return ``h:mm:ss``, or ``m:ss`` below an hour."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"
