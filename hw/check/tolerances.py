"""How far a healthy rig may be from its design, and how probable faults are."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from render.bending import Array

_FINE, _COARSE = np.arange(-4.75, 5.0, 0.25), np.arange(5.0, 30.5, 1.0)
TURNS = np.radians(np.concatenate([-_COARSE[::-1], _FINE, _COARSE]))
"""Turns of a fiber that are considered, rad; finer where healthy ones are, 0 in the middle."""
BRIGHTEST = 2.0
"""Highest relative power that is considered."""
DEAD_BELOW, DIM_BELOW = 0.05, 0.85
"""Relative powers below which a fiber counts as dead or dim."""
LEAST_TURN = np.radians(5.0)
"""Smaller turns are not called a fault."""


@dataclass(frozen=True)
class Tolerances:
    """One standard deviation each, of what differs between a healthy rig and the prediction.

    Arguments:
        power: of a fiber's power, relative.
        turn: of a fiber's direction, rad.
        model: of the prediction of one site's light, relative.
        gain: of the camera's gain per channel, relative; only one image of all fibers needs it.
        noise: of a site's colour, in counts; it may be ``(site,)``.
        fault: probability that a given fiber has a fault, before any image is seen.
        alarm: probability of a fault above which a fiber is reported.
    """

    power: float = 0.08
    turn: float = float(np.radians(1.5))
    model: float = 0.03
    gain: float = 0.05
    noise: Array = field(default_factory=lambda: np.array(0.25))
    fault: float = 0.0005
    alarm: float = 0.5


STARTS = 4
"""Starts of the healthy rig that a good record averages: each has a drift of its own."""
POWER_DRIFT, TURN_DRIFT, SITE_DRIFT = 0.03, float(np.radians(0.5)), 0.002
"""What a healthy rig changes by between two starts: powers, directions, light of single sites."""


def tolerances(*, sweep: bool, starts: int, noise: Array) -> Tolerances:
    """Return what a healthy rig may differ by, for one way of checking.

    Arguments:
        sweep: every fiber alone, or one image of all.
        starts: that the record of the healthy rig averages; 0 compares with the model alone.
        noise: of a site's colour in counts, ``(site,)`` or one for all.
    """
    if not starts:
        return Tolerances(noise=noise)
    # The record has a drift and a noise of its own, less of both the more starts it averages.
    more = np.sqrt(1 + 1 / starts)
    return Tolerances(
        power=more * POWER_DRIFT,
        turn=more * TURN_DRIFT,
        model=more * SITE_DRIFT if sweep else 0.005,
        gain=0.03,
        noise=more * noise,
        fault=0.1 if sweep else 0.0005,
    )
