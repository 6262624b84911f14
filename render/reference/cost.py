"""What renders cost on this machine, and so how many samples fill a given time."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from render.reference.job import RenderJob

MIN_TRIAL_SECONDS = 1.0
"""A trial is long enough when it takes so much longer than the smallest one."""
TRIAL_GROWTH, MAX_TRIAL_UNITS = 4, 4**6
"""Factor between trials, and where they end on a machine that is faster than any."""


@dataclass(frozen=True)
class RenderCost:
    """Seconds of a job, ``fixed + per_sample * samples``.

    What a job is, and what a sample, is up to who measures: a render at one bend and a sample of
    every cell, or a job of `render.reference.job` and one of its samples.

    Example:
        >>> cost = RenderCost.fitted((8, 200), (2.0, 50.0))
        >>> cost.per_sample, cost.samples_within(152.0, [1.0, 1.0])
        (0.25, 304)

    Arguments:
        fixed: seconds of a job that do not depend on its samples.
        per_sample: seconds per sample.
        workers: jobs at once.
    """

    fixed: float
    per_sample: float
    workers: int = 1

    @classmethod
    def fitted(cls, samples: Sequence[float], seconds: Sequence[float]) -> RenderCost:
        """Return the line through a small and a large trial."""
        slope = max(seconds[1] - seconds[0], 1e-6) / (samples[1] - samples[0])
        return cls(max(seconds[0] - slope * samples[0], 0.0), slope)

    def samples_within(self, seconds: float, renders: Sequence[float], at_least: int = 1) -> int:
        """Return the samples that fill ``seconds``.

        The ``seconds`` are of one worker, or of all that work together. ``renders`` says of every
        job that shares them how many times these samples it takes.
        """
        remaining = seconds - self.fixed * len(renders)
        return max(at_least, int(remaining / (self.per_sample * sum(renders))))

    def seconds(self, jobs: Sequence[RenderJob]) -> float:
        """Return how long ``jobs`` take when the workers render them together."""
        spent = [self.fixed + self.per_sample * job.samples for job in jobs]
        rounds = math.ceil(len(jobs) / self.workers)
        return max(sum(spent) / self.workers, max(spent), rounds * sum(spent) / len(jobs))


def trial_cost(
    jobs: Sequence[RenderJob], render: Callable[[list[RenderJob]], Sequence[float]]
) -> RenderCost:
    """Return what renders cost, by trials that grow until they take a time that can be measured.

    ``jobs`` are of one pass or some; longer trials have the same passes more often, so that the
    kernels that the first one compiles serve them all, and nobody measures compiling. ``render``
    returns the seconds of jobs.
    """
    # Other paths: who keeps results would not render these again.
    render([replace(job, seed=job.seed + 1) for job in jobs])

    def seconds(units: int) -> float:
        return sum(render([replace(job, iterations=units * job.iterations) for job in jobs]))

    count, unit = len(jobs), sum(job.samples for job in jobs)
    whole = growing_cost(seconds)
    return RenderCost(whole.fixed / count, whole.per_sample / unit)


def growing_cost(seconds: Callable[[int], float]) -> RenderCost:
    """Return the line through ``seconds`` of 1 unit and of so many that it can be measured."""
    units, small = 1, seconds(1)
    while True:
        units *= TRIAL_GROWTH
        large = seconds(units)
        if large - small >= MIN_TRIAL_SECONDS or units >= MAX_TRIAL_UNITS:
            return RenderCost.fitted((1, units), (small, large))
