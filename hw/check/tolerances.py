"""How far a healthy rig may be from its design, and how probable faults are."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

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


AS_DESIGNED = Tolerances()
"""A rig whose sweep is compared with the model alone."""
COMMISSIONED = Tolerances(
    power=0.034, turn=float(np.radians(0.6)), model=0.0023, gain=0.03, fault=0.1
)
"""A rig whose sweep is compared with how it looked when it was known to be healthy."""
WAYS = {
    (True, False): AS_DESIGNED,
    (True, True): COMMISSIONED,
    (False, False): Tolerances(),
    (False, True): replace(COMMISSIONED, model=0.005, fault=0.0005),
}
"""By whether there is a sweep, and whether there is a record of the healthy rig."""
