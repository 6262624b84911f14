"""Degrees of a reader as a merit of counts: minus what it is expected to miss, at own exposure.

A reader learns from the sensor that it reads: of several, each is calibrated as it was built.
"""

from __future__ import annotations

import numpy as np

from optimize.design import Array
from optimize.objectives import ObjectiveName, ReaderName
from optimize.readers.camera_model import CameraModel
from optimize.readers.named_readers import expected_error
from optimize.scoring import Merit, ScoreMerit, TableScorer
from render.scene import Scene


class ReaderMerit(Merit):
    """Minus the degrees that a ``reader`` is expected to miss, at each design's own exposure."""

    def __init__(
        self, scorer: TableScorer, scene: Scene, reader: ReaderName, camera: CameraModel
    ) -> None:
        """Take the table of ``scorer``, which knows the untouched pad, and a ``reader`` of it.

        Raises:
            TableError: the table has no background.
        """
        super().__init__(scorer, scorer.table.exposure * scorer.table.with_pad)
        self.objective = reader
        self._error = expected_error(reader, scene, camera)

    def values(self, counts: Array) -> Array:
        """Return minus degrees."""
        return -self._error.degrees(counts)

    def slopes(self, counts: Array) -> tuple[float, Array]:
        """Return minus degrees and their derivative."""
        degrees, by_counts = self._error.slopes(counts)
        return -degrees, -by_counts

    def superposed(self, light: Array, power: Array) -> Array:
        """Return counts of light that is interpolated, and nowhere less than none."""
        lit = np.maximum(light, 0.0)
        if self.scorer.table.by_channel:
            return np.asarray(np.einsum("fbskc,fc->bskc", lit, power), dtype=np.float64)
        return np.asarray(np.tensordot(lit, power, (0, 0)), dtype=np.float64)


def merit_of(objective: ObjectiveName, scorer: TableScorer, scene: Scene) -> Merit:
    """Return the merit that ``objective`` names, read by the camera of ``scene``."""
    if objective == "score":
        return ScoreMerit(scorer)
    return ReaderMerit(scorer, scene, objective, CameraModel.of(scene))
