"""How far cells of one level are from those of analog photons."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import stats

MEDIAN_OF_NORMAL = 0.6745
"""Median of the absolute value, in standard deviations."""


class Deviation(NamedTuple):
    """Of cells from the photons'.

    Arguments:
        ratio: of sums, and its ``error``.
        median: of |cell / truth - 1| over cells; ``p95`` its 95th percentile.
        noise: what the photons' own noise makes of the median.
    """

    ratio: float
    error: float
    median: float
    p95: float
    noise: float


def deviation(cells: np.ndarray, truth: np.ndarray) -> Deviation:
    """Return that of ``(cell,)`` from ``(batch, cell)`` of photons."""
    mean, se = truth.mean(axis=0), stats.sem(truth, axis=0)
    known = np.isfinite(mean) & (mean > 0.0)
    off = np.abs(cells[known] / mean[known] - 1.0)
    whole = truth[:, known].sum(axis=1)
    return Deviation(
        float(cells[known].sum() / whole.mean()),
        float(stats.sem(whole) / whole.mean()),
        float(np.median(off)),
        float(np.quantile(off, 0.95)),
        float(MEDIAN_OF_NORMAL * np.median(se[known] / mean[known])),
    )
