"""Which cells of a render have converged, and how many samples more the others would take.

A cell has not converged when its standard error is half its light or more: where few light paths
carry it, that is what its error is at least (``render.reference.error_bars``).
"""

from __future__ import annotations

import numpy as np

from render.arrays import Array

UNCONVERGED = 0.5
"""Relative standard error from which a cell has not converged."""
MOST_EFFORT = 100.0
"""Times the samples beyond which the answer is "more than"."""


def converged(mean: Array, error: Array) -> np.ndarray:
    """Return which cells are above 0 and known to better than UNCONVERGED; False where NaN."""
    return np.asarray((mean > 0) & (error < UNCONVERGED * mean))


def more_samples(mean: Array, error: Array, samples: int | None = None) -> str:
    """Say what would bring nine tenths of the cells there that have not converged.

    Errors fall as 1 over the root of the samples. Without ``samples`` per cell as multiples.
    """
    lost = np.isfinite(mean) & ~converged(mean, error)
    relative = np.divide(error, mean, out=np.full(mean.shape, np.inf), where=mean > 0)[lost]
    times = (np.sort(relative)[int(0.9 * (lost.sum() - 1))] / UNCONVERGED) ** 2
    return more_effort(times, samples)


def more_effort(times: float, samples: int | None = None) -> str:
    """Say that so many ``times`` the samples are needed, as those that are missing per cell.

    Without ``samples`` per cell as multiples.
    """
    about, times = "more than" if times > MOST_EFFORT else "about", min(times, MOST_EFFORT)
    if samples is None:
        return f"{about} {float(f'{max(times, 1.1):.2g}'):g} times the samples are needed"
    more = float(f"{samples * max(times - 1.0, 0.1):.2g}")
    return f"{about} {max(more, 1.0):,.0f} samples more per cell are needed"


def doubt(mean: Array, error: Array, samples: int) -> str:
    """Say how many cells have not converged after ``samples`` each; "" where all that are seen.

    >>> doubt(np.array([1.0, 1.0, np.nan]), np.array([0.1, 1.0, np.nan]), 600)[:58]
    'Not converged: few light paths carry 1 of 2 cells; about 1'
    """
    seen = np.isfinite(mean)
    lost = seen & ~converged(mean, error)
    if not lost.any():
        return ""
    return (
        f"Not converged: few light paths carry {lost.sum():,} of {seen.sum():,} cells; "
        f"{more_samples(mean, error, samples)}."
    )
