"""Levels that answer at once are held against the reference on one scale."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from optimize.frontier.predictors import SCALE_TOLERANCE
from render.scale import scene_scale
from render.scene import load_scene, shipped_scenes
from surrogate.runtime import Checker

MODELS = Path(__file__).parents[3] / "models"


@pytest.mark.slow
@pytest.mark.parametrize("name", shipped_scenes())
def test_shipped_models_are_on_the_scale_of_their_scenes_preview(name: str) -> None:
    """A preview that changes by more than that asks for the models to be made again."""
    model, scale = Checker.load(MODELS / name), scene_scale(load_scene(name))
    np.testing.assert_allclose(
        [model.exposure, model.lam], [scale.exposure, scale.lam], rtol=SCALE_TOLERANCE
    )
