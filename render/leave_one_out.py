"""Statistics of means of replicates without one of them: the jackknife of Tukey (1958)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from render.arrays import Array


def jackknife_se(statistic: Callable[[Array], Array], replicates: Array) -> Array:
    """Return the standard error of a statistic with axes, ``statistic(mean of replicates)``."""
    without = leave_one_out(statistic, replicates)
    return np.asarray(np.sqrt((len(replicates) - 1) * without.var(axis=0)))


def leave_one_out(
    statistic: Callable[[Array], Array] | Callable[[Array], float], replicates: Array
) -> Array:
    """Return ``statistic`` of the means without one replicate, ``(replicate, ...)``."""
    total, count = replicates.sum(axis=0), len(replicates)
    return np.array([statistic((total - one) / (count - 1)) for one in replicates])
