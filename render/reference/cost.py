"""How fast renders are on this machine, from two short ones: what a budget of minutes buys."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from render.arrays import Array
from render.reference.transport import render_transport
from render.scene.schema import Scene

TRIALS = (32, 128)
"""Samples per cell of the trial renders: of ``finger20``, part of a pass and several whole ones.
Their difference is free of the time for compiling, which the first one spends."""


@dataclass(frozen=True)
class RenderPace:
    """Seconds of a render at one bend, ``fixed + each * samples``, and of measuring them.

    Arguments:
        fixed: seconds that do not depend on the samples.
        each: seconds per sample of every (fiber, facet) pair.
        spent: seconds of the trial renders.
    """

    fixed: float
    each: float
    spent: float


def render_pace(scene: Scene, phi: Array) -> RenderPace:
    """Return the pace of renders of ``scene`` at one bend.

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
    each = max(spent[1] - spent[0], 1e-3) / (TRIALS[1] - TRIALS[0])
    return RenderPace(max(spent[0] - each * TRIALS[0], 0.0), each, sum(spent))
