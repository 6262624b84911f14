"""How much work a night does: fixed by a number of samples, or fitted to hours as they pass.

Of the hours, shares go to the transport table, the fit of the surrogate, and the rounds of the
verification loop; the final verification takes one batch of seeds after the other until the rest is
used. Every choice that depends on a clock is logged as a decision before it is acted on.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from render.reference.job import PadJob

TABLE_UNTIL, MODEL_UNTIL, LOOP_UNTIL = 0.40, 0.52, 0.76
"""Shares of the time by whose end these stages have finished."""
OVERTIME_SHARE = 0.04
"""What is still rendering when so much more of the time is over is given up for the next stage."""
REPORT_SECONDS = 8.0
"""What the end of a night takes: measuring finalists and writing files and report."""
JOB_SECONDS = 90.0
"""A render of the table lasts about so long: what a worker that dies can lose."""
MIN_PASSES = 3
"""A table is rendered in so many passes at least, so that a slow machine can do with fewer."""
MAX_ROUNDS, FIXED_ROUNDS = 12, 3
FIXED_SEEDS = 4
FIT_STEPS = (200, 10_000)
"""Fewest and most steps of the networks."""
MIN_SAMPLES = 4
MIN_SHARE = 0.02
"""Part of the time that a round, or a batch of the final verification, gets at least, even where
the stages before have used it up: with fewer paths its answer would be noise."""


@dataclass(frozen=True)
class CostModel:
    """How fast renders are here.

    Arguments:
        fixed: seconds of a job that do not depend on its size.
        each: seconds per sample.
        workers: jobs at once.
    """

    fixed: float
    each: float
    workers: int

    @classmethod
    def of(cls, jobs: Sequence[PadJob], seconds: Sequence[float], workers: int) -> CostModel:
        """Return the cost by small jobs and larger ones of the same pads, in this order."""
        half = len(jobs) // 2
        sizes = [sum(job.samples for job in part) for part in (jobs[:half], jobs[half:])]
        spent = [sum(seconds[:half]), sum(seconds[half:])]
        each = max(spent[1] - spent[0], 1e-3) / (sizes[1] - sizes[0])
        return cls(max(spent[0] - each * sizes[0], 0.0) / half, each, workers)

    def seconds(self, jobs: Sequence[PadJob]) -> float:
        """Return how long ``jobs`` take when they are rendered together."""
        work = sum(self.fixed + self.each * job.samples for job in jobs)
        rounds = math.ceil(len(jobs) / self.workers)
        largest = max(self.fixed + self.each * job.samples for job in jobs)
        return max(work / self.workers, largest, rounds * work / len(jobs))

    def samples(self, unit: Sequence[PadJob], per: int, seconds: float) -> int:
        """Return the samples per cell whose jobs take ``seconds``.

        Arguments:
            unit: the jobs of ``per`` samples per cell.
            per: that number.
            seconds: of all workers together.
        """
        paths = sum(job.samples for job in unit) / per
        free = seconds * min(self.workers, len(unit)) - self.fixed * len(unit)
        return max(MIN_SAMPLES, int(free / (self.each * paths)))


@dataclass(frozen=True)
class FixedBudget:
    """Amounts that follow from ``samples`` of the transport table per cell."""

    samples: int

    @property
    def passes(self) -> int:
        """Passes of the table."""
        return max(1, math.ceil(self.samples / 512))

    @property
    def per_pass(self) -> int:
        """Samples per cell and pass."""
        return math.ceil(self.samples / self.passes)

    @property
    def fit_steps(self) -> int:
        """Steps of the networks; all of them from 2000 samples."""
        low, high = FIT_STEPS
        return min(high, max(low, 5 * self.samples))

    @property
    def round(self) -> int:
        """Samples per cell of a round."""
        return max(MIN_SAMPLES, self.samples // 32)

    @property
    def final(self) -> int:
        """Samples per cell and seed of the final verification."""
        return max(MIN_SAMPLES, self.samples // 16)
