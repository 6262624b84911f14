"""How far a long render is, and how long the rest will take."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Progress:
    """How far a long render is: ``done`` of ``total`` samples, seconds spent and to come."""

    done: int
    total: int
    seconds: float
    eta_seconds: float


class Clock:
    """Counts samples and says how long the rest will take."""

    def __init__(self, total: int, report: Callable[[Progress], None] | None) -> None:
        self.total, self.report = total, report
        self.done = self.worked = 0
        self.began = time.monotonic()

    def seconds(self) -> float:
        """Return the seconds since the render was asked for."""
        return time.monotonic() - self.began

    def skip(self, count: int) -> None:
        """Count samples that an earlier call made."""
        self.done += count
        self.tick(0)

    def tick(self, count: int) -> None:
        """Count samples that were made now."""
        self.done += count
        self.worked += count
        if self.report:
            rate = self.seconds() / self.worked if self.worked else 0.0
            eta = rate * (self.total - self.done)
            self.report(Progress(self.done, self.total, self.seconds(), eta))
