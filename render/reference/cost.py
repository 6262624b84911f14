"""How fast renders are on this machine, from two short ones: what a budget of minutes buys."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from render.arrays import Array
from render.reference.transport import render_transport
from render.scene.schema import Scene

TRIALS = (32, 128)
"""Samples per cell of the trial renders: of ``finger20``, part of a pass and several whole ones.
Their difference is free of the time for compiling, which the first one spends."""


@dataclass(frozen=True)
class RenderCost:
    """Seconds of a render at one bend, ``fixed + per_sample * samples``, and of measuring them.

    Arguments:
        fixed: seconds that do not depend on the samples.
        per_sample: seconds per sample of every (fiber, facet) pair.
        trials: seconds of the trial renders.
    """

    fixed: float
    per_sample: float
    trials: float

    def samples_within(self, seconds: float, renders: Sequence[float]) -> int:
        """Return the samples per cell that fill ``seconds``, trials included; below 1 if too few.

        ``renders`` are all that is rendered: of each, how many times these samples it takes.
        """
        left = seconds - self.trials - self.fixed * len(renders)
        return int(left / (self.per_sample * sum(renders)))


def measure_render_cost(scene: Scene, phi: Array) -> RenderCost:
    """Return what renders of ``scene`` at one bend cost on this machine, by two short ones.

    Arguments:
        scene: the sensor.
        phi: direction nodes in rad, ``(node,)`` or ``(fiber, node)``.
    """
    seconds = []
    for samples in TRIALS:
        began = time.monotonic()
        bend = np.array(scene.bending.angles[:1])
        render_transport(scene, phi, bend, samples=samples, seeds=[0])
        seconds.append(time.monotonic() - began)
    per_sample = max(seconds[1] - seconds[0], 1e-3) / (TRIALS[1] - TRIALS[0])
    return RenderCost(max(seconds[0] - per_sample * TRIALS[0], 0.0), per_sample, sum(seconds))
