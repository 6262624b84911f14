"""Exact derivatives of the score S (eqs. 4.6 and 4.7) by LED powers and fiber directions.

The chain is written out: S by the metric map, M by the counts of the facets, counts by transport
(linear in power, a polynomial in phi). No automatic differentiation, so the base install has it.
Clipped channels have derivative 0, like everything that is constant there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from optimize.design import Array
from optimize.scoring.table_scorer import TableScorer
from render.chebyshev import differentiation_matrix, interpolation_weights
from render.metric import MetricConfig, superposed


@dataclass(frozen=True, eq=False)
class ScoreGradient:
    """S and its derivatives.

    Arguments:
        score: S in counts.
        phi: ``(F,)`` counts per rad.
        power: ``(F, C)`` counts per unit of power in a channel.
        light: ``(F, B, S, K[, C])``, as the table has it: counts per relative change of the fiber's
            light in that cell, in all its colors at once without an axis of channels; what any
            other parameter's derivative is made of.
    """

    score: float
    phi: Array
    power: Array
    light: Array


class Differentiator:
    """Derivatives on one transport table."""

    def __init__(self, scorer: TableScorer) -> None:
        """Differentiate the table's polynomials once."""
        self.scorer = scorer
        table = scorer.table
        exposed = table.exposure * table.T
        self._table = exposed.reshape(*exposed.shape[:2], -1)
        self._slope = np.einsum("ij,fjx->fix", differentiation_matrix(table.phi), self._table)

    def at(self, phi: Array, power: Array, factor: Array | None = None) -> ScoreGradient:
        """Return S and derivatives for ``phi`` ``(F,)`` rad and ``power`` ``(F, C)``.

        ``factor`` ``(F, B, S, K[, C])`` multiplies the light of every fiber in every cell.
        """
        scorer = self.scorer
        weights = interpolation_weights(scorer.table.phi, phi)
        cells = scorer.table.T.shape[2:]
        light = np.einsum("fj,fjx->fx", weights, self._table).reshape(len(phi), *cells)
        slope = np.einsum("fj,fjx->fx", weights, self._slope).reshape(len(phi), *cells)
        tinted = "c" if scorer.table.by_channel else ""
        if factor is not None:
            light, slope = light * factor, slope * factor
        counts = np.asarray(superposed(light, power))
        score, by_counts = score_by_counts(counts, scorer.table.lam, scorer.config)
        by_light = np.einsum(f"bskc,fc->fbsk{tinted}", by_counts, power)
        return ScoreGradient(
            score,
            np.einsum(f"fbsk{tinted},fbsk{tinted}->f", by_light, slope),
            np.einsum(f"bskc,fbsk{tinted}->fc", by_counts, light),
            by_light * light,
        )


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
