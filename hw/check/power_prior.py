"""Integrals over a fiber's unknown power: Gaussian likelihoods, Gaussian or uniform priors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from render.arrays import Array

Prior = Callable[[Array], Array]
"""Density of the relative power, ``(...)`` for ``(...)``."""

STEPS = np.linspace(-5.0, 5.0, 21)
"""Where the integrand is evaluated, in standard deviations of the likelihood."""


@dataclass(frozen=True, eq=False)
class PowerFits:
    """Likelihoods that are Gaussian in the relative power, one per hypothesis.

    Arguments:
        best: ``(n,)`` most likely relative power.
        spread: ``(n,)`` standard deviation.
        likelihood: ``(n,)`` log of the likelihood at its best.
    """

    best: Array
    spread: Array
    likelihood: Array

    def evidence(self, prior: PowerPrior) -> Array:
        """Return the log of the likelihood's mean under ``prior``, ``(n,)``.

        Where the prior is far from the likelihood, the integral starts at the prior's nearest
        power: it is tiny there, but not nothing.
        """
        center = np.clip(self.best, prior.low, prior.high)
        scale = np.minimum(self.spread, prior.high - prior.low)
        power = center[:, None] + STEPS * scale[:, None]
        inside = (power >= prior.low) & (power <= prior.high)
        log_part = (
            np.where(inside, prior.log_density(power), -np.inf)
            - 0.5 * ((power - self.best[:, None]) / self.spread[:, None]) ** 2
        )
        step = (STEPS[1] - STEPS[0]) * scale
        return np.asarray(self.likelihood + np.logaddexp.reduce(log_part, axis=1) + np.log(step))


@dataclass(frozen=True)
class PowerPrior:
    """A prior density of the relative power on ``[low, high]``."""

    low: float
    high: float
    log_density: Prior


def around_one(spread: float) -> PowerPrior:
    """Return the normal density about 1; it is followed to 8 standard deviations."""
    norm = np.log(spread * np.sqrt(2 * np.pi))
    low, high = max(1 - 8 * spread, 0.0), 1 + 8 * spread
    return PowerPrior(low, high, lambda b: -0.5 * ((b - 1) / spread) ** 2 - norm)


def between(low: float, high: float) -> PowerPrior:
    """Return the uniform density."""
    return PowerPrior(low, high, lambda b: np.full(b.shape, -np.log(high - low)))
