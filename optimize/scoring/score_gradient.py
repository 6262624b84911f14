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
from render.metric import superposed
from render.metric_gradient import score_by_counts


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
