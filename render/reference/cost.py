"""What renders cost on this machine, and so how many samples fill a given time."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from render.arrays import Array
from render.reference.job import RenderJob, run_job
from render.reference.transport import samples_of_full_pass, transport_jobs
from render.scene import Scene

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
        trials: seconds of the trial renders that it was measured by.
    """

    fixed: float
    per_sample: float
    workers: int = 1
    trials: float = 0.0

    @classmethod
    def fitted(
        cls, samples: Sequence[float], seconds: Sequence[float], *, jobs: int = 1
    ) -> RenderCost:
        """Return the line through a small and a large trial of ``jobs`` jobs each."""
        slope = max(seconds[1] - seconds[0], 1e-6) / (samples[1] - samples[0])
        return cls(max(seconds[0] - slope * samples[0], 0.0) / jobs, slope)

    def samples_within(self, seconds: float, renders: Sequence[float], at_least: int = 1) -> int:
        """Return the samples that fill ``seconds``, trials included.

        The ``seconds`` are of one worker, or of all that work together. ``renders`` says of every
        job that shares them how many times these samples it takes.
        """
        remaining = seconds - self.trials - self.fixed * len(renders)
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
    units, small = 1, sum(render(list(jobs)))
    while True:
        units *= TRIAL_GROWTH
        longer = [replace(job, iterations=units * job.iterations) for job in jobs]
        large = sum(render(longer))
        if large - small >= MIN_TRIAL_SECONDS or units >= MAX_TRIAL_UNITS:
            break
    samples = [float(sum(job.samples for job in trial)) for trial in (jobs, longer)]
    return RenderCost.fitted(samples, (small, large), jobs=len(jobs))


def measure_render_cost(scene: Scene, phi: Array) -> RenderCost:
    """Return the cost of renders of ``scene`` at one bend, in samples of every cell.

    ``phi`` are direction nodes in rad, ``(node,)`` or ``(fiber, node)``.
    """
    began = time.monotonic()
    unit = samples_of_full_pass(scene)
    # The last bend: bent pads cost more than flat ones.
    jobs = transport_jobs(
        scene, phi, np.array(scene.bending.angles[-1:]), samples=unit, per_pass=unit, seeds=[0]
    )
    cost = trial_cost(jobs, lambda trial: [run_job(job).seconds for job in trial])
    per_cell = sum(job.samples for job in jobs) / unit
    return RenderCost(
        len(jobs) * cost.fixed, per_cell * cost.per_sample, trials=time.monotonic() - began
    )
