"""What the colors of a model may be off by, and what readers' errors in degrees owe to that.

One rule for every design: errors are drawn that are as likely as the model's, lamp by lamp, and
scaled to the spread of colors that held-out renders calibrated (`predicted_spread`). Half of a
lamp's variance is common to a site, the rest each cell's own. How likely an error is does not
depend on which design a search picked, so that intervals hold for what it picks too (Dawid 1994;
Jin and Ren 2024 name what goes wrong otherwise): `tests/validation/test_winners.py`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from optimize.design import Array, Design
from optimize.objectives import READERS, ReaderName
from optimize.readers.camera_model import CameraModel
from optimize.readers.named_readers import expected_error
from optimize.scoring import predicted_colors, predicted_spread
from render.scene import Scene
from surrogate.runtime import Checker

DRAWS = 16
"""Of what a model may be off by."""


@dataclass(frozen=True, eq=False)
class ModelColors:
    """Colors without noise of render, as a model has them.

    Arguments:
        colors: ``(design, B, S, facet + 1, C)``, counts as those of renders.
        errors: ``(draw, design, ...)`` of what they may be off by, counts; a draw is one and the
            same error of the model in all designs.
    """

    colors: Array
    errors: Array

    @classmethod
    def of(cls, checker: Checker | None, designs: Sequence[Design]) -> ModelColors | None:
        """Return those of ``designs``; None without a model."""
        if checker is None:
            return None
        colors = [predicted_colors(checker, design) for design in designs]
        errors = [likely_errors(checker, design) for design in designs]
        return cls(np.stack(colors), np.stack(errors, axis=1))


def likely_errors(checker: Checker, design: Design) -> Array:
    """Return what the colors of ``design`` may be off by, ``(draw, B, S, facet + 1, C)`` counts.

    A lamp that stays as it is has the same errors in all designs; one that is turned has others.
    """

    def lamps() -> Iterable[tuple[Array, Sequence[int]]]:
        for lamp in np.flatnonzero(design.drive.any(axis=1)):
            drive = np.zeros_like(design.drive)
            drive[lamp] = design.drive[lamp]
            turned = round(float(design.phi[lamp]) * 1e6)
            seed = [int(checker.scene_hash, 16), int(lamp), turned]
            yield predicted_colors(checker, replace(design, drive=drive)), seed

    return drawn_errors(predicted_spread(checker, design), lamps())


def drawn_errors(spread: Array, lamps: Iterable[tuple[Array, Sequence[int]]]) -> Array:
    """Return errors ``(draw, B, S, facet + 1, C)`` of colors, with ``spread`` for their deviation.

    ``lamps`` are the light of each alone, of the shape of ``spread``, and the seed of its errors.
    """
    off, square = np.zeros((DRAWS, *spread.shape)), np.zeros(spread.shape)
    states, sites, cells, _ = spread.shape
    for light, seed in lamps:
        rng = np.random.default_rng(seed)
        common = rng.standard_normal((DRAWS, states, sites, 1, 1))
        own = rng.standard_normal((DRAWS, states, sites, cells, 1))
        off += light * (common + own) / np.sqrt(2.0)
        square += light**2
    unit = np.sqrt(square)
    return np.asarray(spread * np.divide(off, unit, out=np.zeros_like(off), where=unit > 0.0))


def model_offsets(scene: Scene, model: ModelColors, camera: CameraModel) -> dict[ReaderName, Array]:
    """Return by how many degrees errors move where colors are off, by reader, ``(draw,)``.

    ``model`` has one design.
    """
    drawn = (model.colors + model.errors)[:, 0]
    found: dict[ReaderName, Array] = {}
    for name in READERS:
        error = expected_error(name, scene, camera)
        found[name] = error.degrees(drawn) - error.degrees(model.colors)
    return found
