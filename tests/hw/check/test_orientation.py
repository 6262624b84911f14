"""Photographs of a square camera may lie on any side, and each is named."""

from __future__ import annotations

import numpy as np
import pytest

from hw.check.orientation import ON_ITS_SIDE, TURNED, check_orientation
from hw.check.prediction import PadPrediction, SiteSpots
from hw.errors import CaptureError
from render.arrays import Array
from render.scene import load_scene, unchecked

SCENE = load_scene("finger20")
SQUARE = unchecked(SCENE, {"camera": unchecked(SCENE.camera, {"columns": 400, "rows": 400})})


@pytest.fixture(scope="module")
def spots() -> SiteSpots:
    return SiteSpots(SQUARE, 0.0)


@pytest.fixture(scope="module")
def photos(spots: SiteSpots, prediction: PadPrediction) -> Array:
    """Draw every fiber's light at the sites, noise elsewhere."""
    rng, shown = np.random.default_rng(0), spots._shown.reshape(-1, 400, 400)
    light = np.einsum("fsc,syx->fyxc", prediction.alone[::4], shown)
    return np.asarray(light + 0.2 * rng.standard_normal(light.shape))


def test_what_is_upright_passes(spots: SiteSpots, photos: Array, prediction: PadPrediction) -> None:
    check_orientation(prediction.alone[::4], photos, spots)
    check_orientation(prediction.alone[::4], 0.3 * photos * [0.5, 1.0, 2.0], spots)


@pytest.mark.parametrize("way", [*TURNED, *ON_ITS_SIDE])
def test_every_other_way_is_named(
    spots: SiteSpots, photos: Array, prediction: PadPrediction, way: str
) -> None:
    undo, _ = (TURNED | ON_ITS_SIDE)[way]
    # A quarter turn undone is three more made.
    turned = np.stack([undo(undo(undo(photo))) for photo in photos])
    with pytest.raises(CaptureError, match=f"the photographs are {way}, allowed"):
        check_orientation(prediction.alone[::4], turned, spots)
