"""How far a healthy rig may be from its design, and how probable faults are."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from render.arrays import Array

_FINE, _COARSE = np.arange(-4.75, 5.0, 0.25), np.arange(5.0, 30.5, 1.0)
TURNS = np.radians(np.concatenate([-_COARSE[::-1], _FINE, _COARSE]))
"""Turns of a fiber that are considered, rad; finer where healthy ones are, 0 in the middle."""
MAX_POWER = 2.0
"""Highest relative power that is considered."""
DEAD_BELOW, DIM_BELOW = 0.05, 0.85
"""Relative powers below which a fiber counts as dead or dim."""
MIN_TURN = np.radians(5.0)
"""Smaller turns are not called a fault."""

MODEL, MODEL_LENGTH_SCALE = 0.03, float(np.radians(40.0))
"""The model's error of one site's light, relative, and the angle over which it changes (rad)."""


@dataclass(frozen=True)
class RigTolerances:
    """One standard deviation each, of what differs between a healthy rig and the prediction.

    Arguments:
        power: of a fiber's power, relative.
        turn: of a fiber's direction, rad.
        model: of one site's light where the fiber points as designed, relative.
        model_turned: of the model's error over all directions, as far as ``model`` leaves it out: a
            record of the healthy rig holds that error at the rig's own directions alone.
        gain: of the camera's gain per channel, relative; only one image of all fibers needs it.
        noise: of a site's color, in counts; it may be ``(site,)`` or ``(site, channel)``.
        fault: probability that a given fiber has a fault, before any image is seen.
        alarm: probability of a fault above which a fiber is reported.
    """

    power: float = 0.08
    turn: float = float(np.radians(1.5))
    model: float = MODEL
    model_turned: float = 0.0
    gain: float = 0.05
    noise: Array = field(default_factory=lambda: np.array(0.25))
    fault: float = 0.0005
    alarm: float = 0.5

    @property
    def site_noise(self) -> Array:
        """Return ``noise`` as ``(site, channel)``, with 1 where all are alike."""
        noise = np.asarray(self.noise)
        return noise if noise.ndim == 2 else noise.reshape(-1, 1)

    def with_powers(self, error: Array) -> RigTolerances:
        """Return these for a rig whose powers are known with ``error`` ``(fiber,)``, and drift."""
        return replace(self, power=min(self.power, float(np.hypot(error.max(), POWER_DRIFT))))

    def model_when_turned(self, turn: Array) -> Array:
        """Return the relative error of one site's light after a turn, ``(n,)`` for ``(n,)`` rad.

        The model's error is taken for a Gaussian process in direction with a squared-exponential
        covariance (Rasmussen and Williams 2006, eq. 4.9): between two directions it differs with
        the variance ``2 model_turned^2 (1 - exp(-(turn / MODEL_LENGTH_SCALE)^2 / 2))``.
        """
        changed = 2 * self.model_turned**2 * -np.expm1(-0.5 * (turn / MODEL_LENGTH_SCALE) ** 2)
        return np.asarray(np.sqrt(self.model**2 + changed))


STARTS = 4
"""Starts of the healthy rig that a good record averages: each has a drift of its own."""
POWER_DRIFT, TURN_DRIFT, SITE_DRIFT = 0.03, float(np.radians(0.5)), 0.002
"""What a healthy rig changes by between two starts: powers, directions, light of single sites."""


def rig_tolerances(*, sweep: bool, starts: int, noise: Array) -> RigTolerances:
    """Return what a healthy rig may differ by, for one way of checking.

    A ``sweep`` is every fiber alone, else one image of all. The record of the healthy rig averages
    ``starts``; 0 compares with the model alone. ``noise`` is that of a site's color in counts,
    ``(site, channel)``, ``(site,)`` or one for all.
    """
    if not starts:
        return RigTolerances(noise=noise)
    # The record has a drift and a noise of its own, less of both the more starts it averages.
    more = np.sqrt(1 + 1 / starts)
    return RigTolerances(
        power=more * POWER_DRIFT,
        turn=more * TURN_DRIFT,
        model=more * SITE_DRIFT if sweep else 0.005,
        model_turned=MODEL if sweep else 0.0,
        gain=0.03,
        noise=more * noise,
        fault=0.1 if sweep else 0.0005,
    )
