"""What the colors of a model may be off by, and what readers' errors in degrees owe to that."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from optimize.design import Array, Design
from optimize.objectives import READERS, ReaderName
from optimize.readers.camera_model import CameraModel
from optimize.readers.named_readers import expected_error
from optimize.scoring import normal_factor, predicted_colors
from render.scene import Scene
from surrogate.runtime import Checker

DRAWS = 16
"""Of what a model may be off by."""


@dataclass(frozen=True, eq=False)
class ModelColors:
    """Colors without noise of render, as a model has them.

    Arguments:
        colors: ``(design, B, S, facet + 1, C)``, counts as those of renders.
        error: one standard deviation of what a color is off by, relative.
    """

    colors: Array
    error: float

    @classmethod
    def of(cls, checker: Checker | None, designs: Sequence[Design]) -> ModelColors | None:
        """Return those of ``designs``; None without a model that knows how wrong it is."""
        error = None if checker is None else model_error(checker)
        if checker is None or error is None:
            return None
        return cls(np.stack([predicted_colors(checker, design) for design in designs]), error)

    def drawn(self, common: np.random.Generator, own: np.random.Generator) -> Array:
        """Return colors that are as likely as the model's.

        Half of the variance is ``common`` to a site, the rest each color's ``own``.
        """
        shape = self.colors.shape[1:]
        shared, alone = common.standard_normal((*shape[:2], 1, 1)), own.standard_normal(shape)
        return np.asarray(self.colors * (1.0 + self.error * (shared + alone) / math.sqrt(2.0)))


def model_error(checker: Checker) -> float | None:
    """Return what a model's colors are off by, one relative standard deviation; None if unknown."""
    known = checker.metadata.own_errors
    if known is None:
        return None
    return math.hypot(known["facet_median"] / normal_factor(0.5), checker.photon_noise or 0.0)


def model_offsets(scene: Scene, model: ModelColors, camera: CameraModel) -> dict[ReaderName, Array]:
    """Return by how many degrees errors move where colors are off, by reader, ``(draw,)``.

    ``model`` has one design. Two designs of a scene share what is common to a site, not the rest:
    for designs that are alike the differences are too wide.
    """
    (colors,) = model.colors
    content = hashlib.sha256(np.ascontiguousarray(colors).tobytes()).digest()
    common = np.random.default_rng(int(scene.hash, 16))
    own = np.random.default_rng(int.from_bytes(content[:8], "big"))
    drawn = np.concatenate([model.drawn(common, own) for _ in range(DRAWS)])
    found: dict[ReaderName, Array] = {}
    for name in READERS:
        error = expected_error(name, scene, camera)
        found[name] = error.degrees(drawn) - error.degrees(model.colors)
    return found
