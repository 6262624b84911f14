"""Exact derivatives of the score S (eqs. 4.6 and 4.7) by the counts of the facets.

The chain is written out, without automatic differentiation, so the base install has it. Clipped
channels have derivative 0, like everything that is constant there.
"""

from __future__ import annotations

import numpy as np

from render.arrays import Array
from render.metric import MetricConfig


def score_by_counts(counts: Array, lam: float, config: MetricConfig) -> tuple[float, Array]:
    """Return S and its derivative ``(B, S, K, C)`` by the unclipped ``counts``, shaped alike."""
    clipped = np.clip(counts, 0.0, config.count_max)
    inside = (counts > 0.0) & (counts < config.count_max)
    length = np.linalg.norm(clipped, axis=-1)
    safe = np.where(length > 0.0, length, 1.0)
    hue = clipped / safe[..., None]
    after = np.roll(hue, -1, axis=-2) - hue
    if not config.cyclic:
        after = after[..., :-1, :]
    step = np.linalg.norm(after, axis=-1)
    brightness, by_length = _mean_minus_std(length, config.ddof)
    contrast, by_step = _mean_minus_std(step, config.ddof)
    metric = brightness + lam * contrast
    score, by_metric = _design_score(metric, config.ddof)
    flow = (lam * by_step / np.where(step > 0.0, step, 1.0))[..., None] * after
    by_hue = np.zeros_like(hue)
    if config.cyclic:
        by_hue = np.roll(flow, 1, axis=-2) - flow
    else:
        by_hue[..., 1:, :] += flow
        by_hue[..., :-1, :] -= flow
    along = (by_hue * hue).sum(axis=-1, keepdims=True)
    by_counts = by_length[..., None] * hue + (by_hue - along * hue) / safe[..., None]
    return score, np.where(inside, by_metric[..., None, None] * by_counts, 0.0)


def _mean_minus_std(values: Array, ddof: int) -> tuple[Array, Array]:
    """Return mean minus standard deviation over the last axis, and its derivative."""
    count = values.shape[-1]
    deviation = values - values.mean(axis=-1, keepdims=True)
    spread = np.sqrt((deviation**2).sum(axis=-1) / (count - ddof))
    safe = np.where(spread > 0.0, spread, 1.0)[..., None]
    return values.mean(axis=-1) - spread, 1.0 / count - deviation / ((count - ddof) * safe)


def _design_score(metric: Array, ddof: int) -> tuple[float, Array]:
    """Return S of ``metric`` ``(B, S)`` and its derivative."""
    bends, sites = metric.shape
    by_site, one = _mean_minus_std(metric.mean(axis=0), ddof)
    by_bend, two = _mean_minus_std(metric.mean(axis=1), ddof)
    mean = metric.mean()
    # Each part counts the mean once; S counts it once in all.
    gradient = one[None, :] / bends + two[:, None] / sites - 1.0 / metric.size
    return float(by_site + by_bend - mean), np.asarray(gradient)
