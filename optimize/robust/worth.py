"""What a sensor's colors are worth, more is better: the score S, or minus a reader's degrees.

Sensors as they are built differ in their colors alone, so both are functions of counts. A reader
learns from the sensor that it reads: each one is calibrated as it was built.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from optimize.design import Array
from optimize.objectives import ObjectiveName, ReaderName, sign_of, unit_of
from optimize.readers import CameraModel, expected_error
from optimize.scoring import TableScorer
from render.chebyshev import differentiation_matrix, interpolation_weights
from render.metric import superposed
from render.metric_gradient import score_by_counts
from render.scene import Scene


class Worth(ABC):
    """What counts are worth on the table of a ``scorer``.

    Arguments of the constructor:
        scorer: the sensor as drawn, and what may be chosen.
        light: its counts per unit of LED power, ``(F, node, B, S, patch[, C])``.
    """

    objective: ObjectiveName

    def __init__(self, scorer: TableScorer, light: Array) -> None:
        self.scorer, self.cells = scorer, light.shape[2:]
        flat = light.reshape(*light.shape[:2], -1)
        slope = np.einsum("ij,fjx->fix", differentiation_matrix(scorer.table.phi), flat)
        self.light = flat, np.asarray(slope)

    @abstractmethod
    def value(self, counts: Array) -> float:
        """Return the worth of unclipped ``counts`` ``(B, S, patch, C)``."""

    @abstractmethod
    def slopes(self, counts: Array) -> tuple[float, Array]:
        """Return the worth and its derivative by ``counts``, of their shape."""

    @property
    def sign(self) -> float:
        """By which a worth is multiplied to be told: errors are told as they are."""
        return sign_of(self.objective)

    @property
    def unit(self) -> str:
        """Of what is told: none for counts, the sign of degrees."""
        return unit_of(self.objective)

    def weights(self, phi: Array) -> Array:
        """Return what each node counts at directions ``phi`` ``(F,)`` rad, ``(F, 1, node)``."""
        return np.asarray(interpolation_weights(self.scorer.table.phi, phi)[:, None])

    def at(self, phi: Array) -> tuple[Array, Array]:
        """Return the light at ``phi`` ``(F,)`` rad, and its derivative, ``(F, cell)`` each."""
        weights = self.weights(phi)
        light, slope = (np.asarray(weights @ part)[:, 0] for part in self.light)
        return light, slope

    def superposed(self, light: Array, power: Array) -> Array:
        """Return counts ``(B, S, patch, C)`` of ``light`` ``(F, cell)``, power ``(F, C)``."""
        return np.asarray(superposed(light.reshape(len(light), *self.cells), power))

    def chain(self, by_counts: Array, light: Array, power: Array) -> tuple[Array, Array]:
        """Return derivatives by ``light``, of its shape, and by ``power`` ``(F, C)``."""
        tinted = "c" if self.scorer.table.by_channel else ""
        by_light = np.einsum(f"bskc,fc->fbsk{tinted}", by_counts, power)
        shaped = light.reshape(len(light), *self.cells)
        by_power = np.einsum(f"bskc,fbsk{tinted}->fc", by_counts, shaped)
        return by_light.reshape(light.shape), by_power


class ScoreWorth(Worth):
    """S of eq. (4.7), in counts."""

    objective: ObjectiveName = "score"

    def __init__(self, scorer: TableScorer) -> None:
        """Take the facets of the table of ``scorer``."""
        super().__init__(scorer, scorer.table.exposure * scorer.table.T)

    def value(self, counts: Array) -> float:
        """Return S."""
        flat = counts.reshape(-1, counts.shape[-1], 1)
        return float(self.scorer.score_block(flat)[0])

    def slopes(self, counts: Array) -> tuple[float, Array]:
        """Return S and its derivative."""
        return score_by_counts(counts, self.scorer.table.lam, self.scorer.config)


class ReaderWorth(Worth):
    """Minus the degrees that a reader is expected to miss, at each sensor's own exposure."""

    def __init__(self, scorer: TableScorer, scene: Scene, reader: ReaderName) -> None:
        """Take facets and untouched pad of the table of ``scorer``.

        Raises:
            TableError: the table has no background.
        """
        super().__init__(scorer, scorer.table.exposure * scorer.table.with_pad)
        self.objective = reader
        self._error = expected_error(reader, scene, CameraModel.of(scene))

    def value(self, counts: Array) -> float:
        """Return minus degrees."""
        return -float(self._error.degrees(np.maximum(counts, 0.0)[None])[0])

    def slopes(self, counts: Array) -> tuple[float, Array]:
        """Return minus degrees and their derivative."""
        degrees, by_counts = self._error.slopes(np.maximum(counts, 0.0))
        return -degrees, -by_counts


def worth_of(objective: ObjectiveName, scorer: TableScorer, scene: Scene) -> Worth:
    """Return the worth that ``objective`` names."""
    if objective == "score":
        return ScoreWorth(scorer)
    return ReaderWorth(scorer, scene, objective)
