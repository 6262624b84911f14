"""What may be wrong with a model of the light, as smooth fields, and what renders say about it.

The model's log light is wrong by fields over the pad that are smooth in a fiber's frame: Gaussian
processes with a squared-exponential covariance (Rasmussen and Williams 2006, eq. 4.9). The
covariance is split into modes, each with an amplitude of standard deviation 1 (Karhunen-Loeve;
section 4.3 there), which the fit finds together with the material: what a likely error of the model
explains is not taken for another material. Renders give log ratios with their errors, part by part.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hw.calibration.reference_lines import frame_positions
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


ErrorModes = tuple[Array, ...]
"""For each bend ``(mode, fiber, point)`` log light, 0 at fibers that it is not about."""

LENGTH_SCALE = 3.0
LOG_LENGTH_SCALE = 0.5
"""Length scales of the ratio of rendered to drawn light: mm beside a fiber's axis, and the
logarithm of the distance from the edge. The most likely kernel of thirteen on renders of finger20
at three materials, better than one length scale for both by 5 to 22 in log likelihood."""
MIN_DISTANCE = 0.3
"""Distance (mm) from the edge below which nothing changes any more."""
STRETCHES = (0.4, 1.0, 3.0)
"""Length scales of errors, in those of the ratio: ripples, and what looks like absorption."""
DROPPED_VARIANCE = 1e-2
"""Fraction of the variance that modes may leave out."""


def kernel(a: Array, b: Array, stretch: float = 1.0) -> Array:
    """Return the covariance ``(n, m)`` of fields at places ``(n, 2)`` and ``(m, 2)``, variance 1.

    Places are mm in a fiber's frame; ``stretch`` multiplies the length scales.
    """
    across = (a[:, None, 0] - b[None, :, 0]) / (stretch * LENGTH_SCALE)
    logs = [np.log(np.maximum(places[:, 1], MIN_DISTANCE)) for places in (a, b)]
    outwards = (logs[0][:, None] - logs[1][None]) / (stretch * LOG_LENGTH_SCALE)
    return np.asarray(np.exp(-0.5 * (across**2 + outwards**2)))


def modes_of(covariance: Array) -> Array:
    """Return modes ``(mode, n)`` whose outer products sum to ``covariance`` ``(n, n)``."""
    variance, direction = np.linalg.eigh(covariance)
    variance = np.maximum(variance[::-1], 0.0)
    kept = (1 - DROPPED_VARIANCE) * variance.sum()
    count = int(np.searchsorted(np.cumsum(variance), kept)) + 1
    return np.asarray((np.sqrt(variance[:count]) * direction[:, ::-1][:, :count]).T)


def field_modes(size: Array, fibers: int) -> ErrorModes:
    """Return the modes of fields of relative ``size`` ``(bend,)``, half common to all fibers.

    A third each has a shorter length scale than corrections, the same, and that of the whole pad.
    """
    place = frame_positions()
    own = modes_of(np.mean([kernel(place, place, stretch) for stretch in STRETCHES], axis=0))
    count = len(own)
    whole = np.zeros((count * (fibers + 1), fibers, len(place)))
    whole[:count] = own[:, None]
    for fiber in range(fibers):
        whole[count * (fiber + 1) : count * (fiber + 2), fiber] = own
    return tuple(np.sqrt(0.5) * bend_size * whole for bend_size in size)
