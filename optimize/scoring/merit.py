"""Merit functions of counts, more is better, with exact derivatives; that of S is here.

The chain of derivatives is written out: merit by counts, counts by transport (linear in power, a
polynomial in phi). No automatic differentiation, so the base install has it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from optimize.design import Array
from optimize.objectives import ObjectiveName, sign_of
from optimize.scoring.table_scorer import TableScorer
from render.chebyshev import differentiation_matrix, interpolation_weights
from render.metric import superposed
from render.metric_gradient import score_by_counts


@dataclass(frozen=True, eq=False)
class MeritGradient:
    """A merit and its derivatives.

    Arguments:
        value: the merit.
        phi: ``(F,)`` per rad.
        power: ``(F, C)`` per unit of power in a channel.
        light: ``(F, B, S, patch[, C])``, as the table has it: per relative change of the fiber's
            light in that cell, in all its colors at once without an axis of channels; what any
            other parameter's derivative is made of.
    """

    value: float
    phi: Array
    power: Array
    light: Array


class Merit(ABC):
    """A merit of counts on the table of a ``scorer``.

    Arguments of the constructor:
        scorer: the sensor as drawn, and what may be chosen.
        light: its counts per unit of LED power, ``(F, node, B, S, patch[, C])``.
    """

    objective: ObjectiveName

    def __init__(self, scorer: TableScorer, light: Array) -> None:
        self.scorer, self.cells = scorer, light.shape[2:]
        flat = light.reshape(*light.shape[:2], -1)
        slope = np.einsum("ij,fjx->fix", differentiation_matrix(scorer.table.phi), flat)
        self._light, self._slope = flat, np.asarray(slope)

    @abstractmethod
    def values(self, counts: Array) -> Array:
        """Return the merits ``(N,)`` of unclipped ``counts`` ``(N, B, S, patch, C)``."""

    @abstractmethod
    def slopes(self, counts: Array) -> tuple[float, Array]:
        """Return the merit of ``counts`` ``(B, S, patch, C)`` and its derivative, shaped alike."""

    @property
    def sign(self) -> float:
        """By which a merit is multiplied to be told: errors are told as they are."""
        return sign_of(self.objective)

    def value(self, phi: Array, power: Array) -> float:
        """Return the merit for ``phi`` ``(F,)`` rad and ``power`` ``(F, C)``."""
        return float(self.values(self.superposed(self.light(phi), power)[None])[0])

    def gradient(self, phi: Array, power: Array) -> MeritGradient:
        """Return the merit and its derivatives for ``phi`` ``(F,)`` rad and ``power`` ``(F, C)``.

        A channel that is clipped has derivative 0, like everything that is constant there.
        """
        return self.gradient_by(self.light(phi), self.turned(phi), power)

    def light(self, phi: Array) -> Array:
        """Return counts per unit of LED power at ``phi`` ``(F,)`` rad, ``(F, *cells)``."""
        return self.at(self._light, phi)

    def turned(self, phi: Array) -> Array:
        """Return the derivative of `light` by ``phi``, per rad."""
        return self.at(self._slope, phi)

    def at(self, values: Array, phi: Array) -> Array:
        """Return ``values`` ``(F, node, cell)`` at ``phi`` ``(F,)`` rad, ``(F, *cells)``."""
        weights = interpolation_weights(self.scorer.table.phi, phi)
        return np.asarray((weights[:, None] @ values).reshape(len(phi), *self.cells))

    def flat(self, values: Array) -> Array:
        """Return ``values`` ``(F, node, B, S, facet + 1[, C])`` of these cells alone, flat."""
        own = values[:, :, :, :, : self.cells[2]]
        return own.reshape(*own.shape[:2], -1)

    def superposed(self, light: Array, power: Array) -> Array:
        """Return counts ``(B, S, patch, C)`` of ``light`` ``(F, *cells)``, power ``(F, C)``."""
        return np.asarray(superposed(light, power))

    def gradient_by(self, light: Array, turned: Array, power: Array) -> MeritGradient:
        """Return the gradient where ``light`` changes by ``turned`` per rad of each fiber."""
        value, by_counts = self.slopes(self.superposed(light, power))
        tinted = "c" if self.scorer.table.by_channel else ""
        by_light = np.einsum(f"bskc,fc->fbsk{tinted}", by_counts, power)
        return MeritGradient(
            value,
            (by_light * turned).reshape(len(light), -1).sum(axis=1),
            np.einsum(f"bskc,fbsk{tinted}->fc", by_counts, light),
            by_light * light,
        )


class ScoreMerit(Merit):
    """S of eq. (4.7), in counts."""

    objective: ObjectiveName = "score"

    def __init__(self, scorer: TableScorer) -> None:
        """Take the facets of the table of ``scorer``."""
        super().__init__(scorer, scorer.table.exposure * scorer.table.T)

    def values(self, counts: Array) -> Array:
        """Return S."""
        lanes = counts.reshape(len(counts), -1, counts.shape[-1])
        return self.scorer.score_block(np.moveaxis(lanes, 0, -1))

    def slopes(self, counts: Array) -> tuple[float, Array]:
        """Return S and its derivative."""
        return score_by_counts(counts, self.scorer.table.lam, self.scorer.config)
