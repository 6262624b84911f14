"""What renders cost on this machine, and so how many samples fill a given time."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from render.arrays import Array
from render.files import read_json, write_json
from render.reference.job import RenderJob
from render.reference.transport import render_transport
from render.scene import Scene

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

TRIALS = (32, 128)
"""Samples per cell of the trial renders: of ``finger20``, part of a pass and several whole ones.
Their difference is free of the time for compiling, which the first one spends."""
MIN_SLOPE_SECONDS = 1e-3
"""Least difference between a small and a large trial that is believed."""


@dataclass(frozen=True)
class RenderCost:
    """Seconds of a job, ``fixed + per_sample * samples``.

    What a job is, and what a sample, is up to who measures: a render at one bend and a sample of
    every cell, or a job of `render.reference.job` and one of its samples.

    Example:
        >>> cost = RenderCost.fitted((8, 200), (2.0, 50.0))
        >>> cost.per_sample, cost.samples_within(152.0, [1.0, 1.0])
        (0.25, 200)

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
        slope = max(seconds[1] - seconds[0], MIN_SLOPE_SECONDS) / (samples[1] - samples[0])
        return cls(max(seconds[0] - slope * samples[0], 0.0) / jobs, slope, trials=sum(seconds))

    def samples_within(self, seconds: float, renders: Sequence[float], at_least: int = 1) -> int:
        """Return the samples that fill ``seconds``, trials included.

        Arguments:
            seconds: of one worker, or of all that work together.
            renders: all jobs that share the time: of each, how many times these samples it takes.
            at_least: what is rendered however little time there is.
        """
        remaining = seconds - self.trials - self.fixed * len(renders)
        return max(at_least, int(remaining / (self.per_sample * sum(renders))))

    def seconds(self, jobs: Sequence[RenderJob]) -> float:
        """Return how long ``jobs`` take when the workers render them together."""
        spent = [self.fixed + self.per_sample * job.samples for job in jobs]
        rounds = math.ceil(len(jobs) / self.workers)
        return max(sum(spent) / self.workers, max(spent), rounds * sum(spent) / len(jobs))


def measure_render_cost(scene: Scene, phi: Array) -> RenderCost:
    """Return the cost of renders of ``scene`` at one bend, by two short ones.

    Arguments:
        scene: the sensor.
        phi: direction nodes in rad, ``(node,)`` or ``(fiber, node)``.
    """
    spent = []
    for samples in TRIALS:
        began = time.monotonic()
        bend = np.array(scene.bending.angles[:1])
        render_transport(scene, phi, bend, samples=samples, seeds=[0])
        spent.append(time.monotonic() - began)
    return RenderCost.fitted(TRIALS, spent)


Plan = TypeVar("Plan", bound="DataclassInstance")


def stored_plan(
    path: Path, kind: type[Plan], wanted: dict[str, Any], make: Callable[[], Plan]
) -> Plan:
    """Return the plan in ``path``, so that a resumed run renders the same, or make one and keep it.

    Arguments:
        path: of the JSON file.
        kind: dataclass of the plan.
        wanted: fields that a stored plan must agree with.
        make: chooses what is rendered, perhaps after timing trial renders.
    """
    try:
        stored = kind(**read_json(path))
    except TypeError:
        stored = None
    if stored is not None and all(getattr(stored, key) == value for key, value in wanted.items()):
        return stored
    plan = make()
    write_json(path, asdict(plan))
    return plan
