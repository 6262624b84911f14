"""Rendered light over drawn light of one material: smooth over the pad, much alike for all fibers.

The renders' own noise is neither. So the logarithm of the ratio is taken as a Gaussian process in
the fiber's frame (Rasmussen and Williams 2006, eq. 2.25 and 2.26): a constant of each fiber, a
field that all fibers share, and a field of its own for each.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import cho_solve, solve_triangular

from hw.calibration.log_ratio import LogRatios
from hw.calibration.model_error import kernel
from render.arrays import Array

SHARED_AMPLITUDES = (0.02, 0.04, 0.08, 0.16, 0.32)
FIBER_AMPLITUDES = (0.0, 0.005, 0.01, 0.02, 0.04, 0.08)
"""Prior standard deviations of the shared and the fibers' own fields, relative; the data choose."""
CONSTANT_STD = 1.0
"""Prior standard deviation of each fiber's constant: nothing is known of it, its power takes it
up."""


class SmoothRatio:
    """The process, told what renders say; ``data`` has one entry per fiber.

    Raises:
        ValueError: no data at all.
    """

    def __init__(self, data: Sequence[LogRatios]) -> None:
        """Choose the fields' sizes by the data's marginal likelihood (eq. 2.30)."""
        self._seen = [ratios.place for ratios in data]
        self._values = np.concatenate([ratios.log_ratio for ratios in data])
        if not len(self._values):
            raise ValueError("no render tells anything about the ratio")
        noise = np.diag(np.concatenate([ratios.variance for ratios in data]))
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
        near, same = _kernels(wanted, self._seen)
        across = CONSTANT_STD**2 * same + near * (self.shared**2 + self.own**2 * same)
        return np.asarray(across @ cho_solve((self._root, True), self._values))


def _kernels(a: Sequence[Array], b: Sequence[Array]) -> tuple[Array, Array]:
    """Return the kernel of places in the fiber's frame, and whether they are of the same fiber."""
    fiber = [np.repeat(np.arange(len(side)), [len(place) for place in side]) for side in (a, b)]
    place = [np.concatenate(side) for side in (a, b)]
    same = (fiber[0][:, None] == fiber[1][None]).astype(np.float64)
    return kernel(place[0], place[1]), same
