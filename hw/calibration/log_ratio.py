"""What renders say about a model of the light: log ratios with their errors, part by part."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from render.arrays import Array

MAX_RELATIVE_ERROR = 0.3
"""Relative error of rendered light from which it tells nothing."""
MIN_PARTS = 12
"""Parts below which all have the same variance."""
LOG_BIAS = 0.15
"""By how much the logarithm of a variance from 8 replicates is too small on average."""


@dataclass(frozen=True, eq=False)
class LogRatios:
    """Log of rendered over modeled light of one fiber.

    Arguments:
        place: ``(n, 2)`` mm in the fiber's frame: beside its axis, from the edge.
        log_ratio: ``(n,)``; variance: ``(n,)`` of it, independent.
    """

    place: Array
    log_ratio: Array
    variance: Array

    def at(self, chosen: NDArray[np.bool_]) -> LogRatios:
        """Return those that are ``chosen`` ``(n,)``."""
        return LogRatios(self.place[chosen], self.log_ratio[chosen], self.variance[chosen])


def log_ratios(
    place: Array, part: Array, radiance: Array, error: Array, log_light: Array
) -> LogRatios:
    """Return one sample per part of the pad.

    Arguments:
        place: ``(n, 2)`` mm in the fiber's frame.
        part: ``(n,)`` number of the part that each place lies in.
        radiance: ``(n,)`` rendered, NaN where nothing was.
        error: ``(n,)`` its standard error.
        log_light: ``(n,)`` of the model, NaN where nothing is wanted.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        relative = error / radiance
        useful = np.isfinite(log_light) & np.isfinite(relative) & (radiance > 0)
        useful &= error > 0
    ratio = np.log(radiance[useful]) - log_light[useful]
    _, index, size = np.unique(part[useful], return_inverse=True, return_counts=True)

    def mean(values: Array) -> Array:
        return np.asarray(np.bincount(index, values) / size)

    middle = np.stack([mean(values) for values in place[useful].T], axis=-1)
    variance = _smooth(middle, mean(relative[useful] ** 2))
    known = variance < MAX_RELATIVE_ERROR**2
    # The logarithm of a noisy mean is too small by half its relative variance.
    log_ratio = mean(ratio) + 0.5 * variance
    return LogRatios(middle, log_ratio, variance).at(known)


def _smooth(place: Array, variance: Array) -> Array:
    """Return variances ``(n,)`` as a smooth function of the place.

    Rendered light has heavy tails: where it came out too dark, its own error came out too small,
    and weights by such errors would make everything too dark.
    """
    if len(variance) < MIN_PARTS:
        return np.full(len(variance), variance.mean() if len(variance) else np.nan)
    terms, level = quadratic_terms(place), np.log(variance)
    return np.asarray(np.exp(terms @ np.linalg.lstsq(terms, level, rcond=None)[0] + LOG_BIAS))


def quadratic_terms(place: Array) -> Array:
    """Return the terms ``(..., 6)`` of a polynomial of the second degree at ``(..., 2)`` mm."""
    x, y = place[..., 0] / 10.0, place[..., 1] / 10.0
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1)
