"""How far long work is, and how long the rest will take."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace


@dataclass(frozen=True)
class Progress:
    """How far long work is.

    Arguments:
        done: units of work that are finished: samples, starts, previews.
        total: units in all.
        seconds: spent so far.
        eta_seconds: to come; None where nobody knows.
        stage: what is being worked on; empty where it is only one thing.
        note: a sentence that stays for the person who waits; usually empty.
    """

    done: float
    total: float
    seconds: float = 0.0
    eta_seconds: float | None = None
    stage: str = ""
    note: str = ""

    @classmethod
    def of_note(cls, text: str) -> Progress:
        """Return a sentence for the person who waits, and nothing of the work."""
        return cls(0.0, 0.0, note=text)


OnProgress = Callable[[Progress], None]
"""What long work calls, every few seconds or after every unit."""


def in_stage(report: OnProgress | None, stage: str) -> OnProgress | None:
    """Return what tells ``report`` of work that is a stage of something longer."""
    return None if report is None else lambda at: report(replace(at, stage=stage))


class Clock:
    """Counts units of work and says how long the rest will take."""

    def __init__(self, total: int, report: OnProgress | None, stage: str = "") -> None:
        self.total, self.report, self.stage = total, report, stage
        self.done = self.worked = 0
        self.began = time.monotonic()

    def seconds(self) -> float:
        """Return the seconds since the work began."""
        return time.monotonic() - self.began

    def skip(self, count: int) -> None:
        """Count units that were finished before."""
        self.done += count
        self.tick(0)

    def tick(self, count: int = 1) -> None:
        """Count units that were finished now."""
        self.done += count
        self.worked += count
        if self.report:
            spent, left = self.seconds(), self.total - self.done
            known = bool(self.worked) or not left
            eta = spent / max(self.worked, 1) * left if known else None
            self.report(Progress(self.done, self.total, spent, eta, self.stage))
