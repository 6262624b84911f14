"""Sweeps in single colors tell which channel sees which LED, and how surely."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest

from hw.calibration.calibration import calibrated_toml
from hw.calibration.material_table import MaterialTable
from hw.calibration.response import measured_response
from hw.calibration.rig_fit import fit_rig
from hw.camera.photo_set import PhotoSet
from hw.errors import CalibrationError
from render.arrays import Array
from render.scene import Scene, load_scene, scene_text, unchecked
from tests.hw.calibration.toy import photographs, toy_model

TRUE = np.array([[0.8, 0.06, 0.01], [0.09, 1.0, 0.12], [0.0, 0.05, 0.5]])
"""Of LED colors (rows) in channels (columns)."""


def sweeps(scene: Scene, spread: float, seed: int = 0, fibers: int = 6) -> list[PhotoSet]:
    """Return photographs of flat light, whose LEDs differ by ``spread`` from fiber to fiber."""
    rng = np.random.default_rng(seed)
    size = (scene.camera.rows, scene.camera.columns)
    light = np.exp(0.3 * rng.standard_normal(fibers))
    sets = []
    for of_color in TRUE:
        own = np.exp(spread * rng.standard_normal(fibers))
        sets.append(PhotoSet(
            {fiber: 50 * light[fiber] * own[fiber] * np.tile(of_color, (*size, 1))
             + 2.55 * rng.standard_normal((*size, 3)) for fiber in range(fibers)}, None,
        ))  # fmt: skip
    return sets


@pytest.fixture(scope="module")
def small(scene: Scene) -> Scene:
    """Return the sensor with few pixels, for speed."""
    camera = unchecked(scene.camera, {"rows": 100, "columns": 60})
    return unchecked(scene, {"camera": camera})


def test_leds_that_are_alike_give_the_matrix_itself(small: Scene) -> None:
    found = measured_response(small, sweeps(small, 0.0))
    np.testing.assert_allclose(found.matrix, TRUE, atol=0.002)
    assert found.matrix.max() == 1.0
    assert found.error.max() < 0.002


def test_errors_cover_leds_that_differ_from_fiber_to_fiber(small: Scene) -> None:
    z: list[Array] = []
    for seed in range(20):
        found = measured_response(small, sweeps(small, 0.1, seed))
        # Those that are seen well: elsewhere the noise of pixels, cut at 0, is all that is left.
        seen = (TRUE > 0.04) & (found.error > 1e-9)
        z.append(((found.matrix - TRUE) / np.where(seen, found.error, 1.0))[seen])
    rms = np.sqrt(np.mean(np.concatenate(z) ** 2))
    assert 0.7 < rms < 1.6


def test_a_color_that_is_dark_or_missing_raises_one_clear_error(small: Scene) -> None:
    red, green, blue = sweeps(small, 0.0)
    dark = PhotoSet({fiber: 0.0 * photo for fiber, photo in green.alone.items()}, None)
    with pytest.raises(CalibrationError, match=r"green light alone gives 0\.00 counts"):
        measured_response(small, [red, dark, blue])
    other = PhotoSet({fiber + 3: photo for fiber, photo in blue.alone.items() if fiber > 1}, None)
    with pytest.raises(CalibrationError, match="1 fiber was photographed in all of red"):
        measured_response(small, [red, green, other])


def test_the_calibrated_scene_has_the_leds_as_they_are_seen(
    scene: Scene, small: Scene, table: MaterialTable, tmp_path: Path
) -> None:
    found = fit_rig(scene, toy_model(table), photographs(scene)[0])
    response = measured_response(small, sweeps(small, 0.0))
    text = calibrated_toml(scene_text("finger20"), scene, found, "2026-01-31", response)
    path = tmp_path / "scene.toml"
    path.write_text(text, encoding="utf-8")
    after = load_scene(path)
    np.testing.assert_allclose(after.palette.matrix, response.matrix, rtol=1e-3, atol=1e-4)
    for color in tomllib.loads(text)["colors"]:
        assert color["response"]["source"].startswith("calibrated 2026-01-31, 95 % intervals ")
