"""Rendered light over modeled light: smooth over the pad and alike for all fibers.

The renders' own noise is neither. So the logarithm of the ratio is taken as a Gaussian process in
the fiber's frame (Rasmussen and Williams 2006, eq. 2.25 and 2.26): a constant of each fiber, a
field that all fibers share, and a field of its own for each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve, solve_triangular

from render.arrays import Array
from render.geometry.layout import flat_fiber_poses
from render.scene.schema import Scene

LENGTH_SCALE = 3.0
LOG_LENGTH_SCALE = 0.5
"""Length scales of the ratio: mm beside a fiber's axis, and the logarithm of the distance from the
edge. The most likely kernel of thirteen on renders of finger20 at three materials, better than one
length scale for both by 5 to 22 in log likelihood."""
MIN_DISTANCE = 0.3
"""Distance (mm) from the edge below which nothing changes any more."""
SHARED_AMPLITUDES = (0.02, 0.04, 0.08, 0.16, 0.32)
FIBER_AMPLITUDES = (0.0, 0.005, 0.01, 0.02, 0.04, 0.08)
"""Amplitudes, relative, of the field that fibers share and of each one's own; the data choose."""
CONSTANT_STD = 1.0
"""Prior standard deviation of each fiber's constant: nothing is known of it, its power
takes it up."""
MAX_RELATIVE_ERROR = 0.3
"""Relative error of rendered light from which it tells nothing."""
MIN_CELLS = 12
LOG_BIAS = 0.15
"""By how much the logarithm of a variance from 8 replicates is too small on average."""


@dataclass(frozen=True, eq=False)
class LogRatios:
    """What renders say about one fiber.

    Arguments:
        place: ``(n, 2)`` mm in the fiber's frame: beside its axis, from the edge.
        log_ratio: ``(n,)``; variance: ``(n,)`` of it, independent.
    """

    place: Array
    log_ratio: Array
    variance: Array


def ratios(place: Array, part: Array, radiance: Array, error: Array, log_light: Array) -> LogRatios:
    """Return one sample per part of the pad.

    Arguments:
        place: ``(n, 2)`` mm in the fiber's frame.
        part: ``(n,)`` number of the part that each place lies in.
        radiance: ``(n,)`` rendered, NaN where nothing was.
        error: ``(n,)`` its standard error.
        log_light: ``(n,)`` of the model.
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
    variance = _steady(middle, mean(relative[useful] ** 2))
    known = variance < MAX_RELATIVE_ERROR**2
    # The logarithm of a noisy mean is too small by half its relative variance.
    found = mean(ratio) + 0.5 * variance
    return LogRatios(middle[known], found[known], variance[known])


def _steady(place: Array, variance: Array) -> Array:
    """Return variances ``(n,)`` as a smooth function of the place.

    Rendered light has heavy tails: where it came out too dark, its own error came out too small,
    and weights by such errors would make everything too dark.
    """
    if len(variance) < MIN_CELLS:
        return np.full(len(variance), variance.mean() if len(variance) else np.nan)
    x, y = place.T / 10.0
    terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1)
    level = np.log(variance)
    return np.asarray(np.exp(terms @ np.linalg.lstsq(terms, level, rcond=None)[0] + LOG_BIAS))


class SmoothRatio:
    """The process, told what renders say; ``data`` has one entry per fiber.

    Raises:
        ValueError: no data at all.
    """

    def __init__(self, data: Sequence[LogRatios]) -> None:
        """Choose the fields' sizes by the data's marginal likelihood (eq. 2.30)."""
        self._seen = [one.place for one in data]
        self._values = np.concatenate([one.log_ratio for one in data])
        if not len(self._values):
            raise ValueError("no render tells anything about the ratio")
        noise = np.diag(np.concatenate([one.variance for one in data]))
        near, same = _kernels(self._seen, self._seen)
        best = -np.inf
        for shared in SHARED_AMPLITUDES:
            for own in FIBER_AMPLITUDES:
                whole = CONSTANT_STD**2 * same + near * (shared**2 + own**2 * same) + noise
                root = np.linalg.cholesky(whole)
                white = solve_triangular(root, self._values, lower=True)
                likelihood = -0.5 * float(white @ white) - float(np.log(np.diag(root)).sum())
                if likelihood > best:
                    best, self.shared, self.own, self._root = likelihood, shared, own, root

    def mean(self, wanted: Sequence[Array]) -> Array:
        """Return the log ratio at places ``(n, 2)`` of every fiber, one after the other."""
        across = self._covariance(wanted, self._seen)
        return np.asarray(across @ cho_solve((self._root, True), self._values))

    def _covariance(self, a: Sequence[Array], b: Sequence[Array]) -> Array:
        near, same = _kernels(a, b)
        return np.asarray(CONSTANT_STD**2 * same + near * (self.shared**2 + self.own**2 * same))


def in_frame(scene: Scene, fiber: int, position: Array) -> Array:
    """Return flat positions ``(..., 2)`` mm in a fiber's frame: beside its axis, from the edge."""
    poses = flat_fiber_poses(scene)
    away = position - poses.position[fiber, :2]
    margin = scene.fibers.gap + (scene.diffuser.thickness if scene.diffuser else 0.0)
    return np.stack(
        [away @ poses.along[fiber, :2], away @ poses.inward[fiber, :2] - margin], axis=-1
    )


def kernel(a: Array, b: Array, stretch: float = 1.0) -> Array:
    """Return the covariance ``(n, m)`` of errors at places ``(n, 2)`` and ``(m, 2)`` mm.

    Squared exponential of variance 1 (Rasmussen and Williams 2006, eq. 4.9), with ``stretch`` times
    the usual length scales.
    """
    across = (a[:, None, 0] - b[None, :, 0]) / (stretch * LENGTH_SCALE)
    logs = [np.log(np.maximum(places[:, 1], MIN_DISTANCE)) for places in (a, b)]
    outwards = (logs[0][:, None] - logs[1][None]) / (stretch * LOG_LENGTH_SCALE)
    return np.asarray(np.exp(-0.5 * (across**2 + outwards**2)))


def _kernels(a: Sequence[Array], b: Sequence[Array]) -> tuple[Array, Array]:
    """Return the kernel of places in the fiber's frame, and whether they are of the same fiber."""
    own = [np.repeat(np.arange(len(side)), [len(place) for place in side]) for side in (a, b)]
    where = [np.concatenate(side) for side in (a, b)]
    same = (own[0][:, None] == own[1][None]).astype(np.float64)
    return kernel(where[0], where[1]), same
