"""From 20 noisy photographs of an emulated rig to its material, with a flawed camera between."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hw.calibration.calibration import render_report, told
from hw.calibration.material_table import MaterialTable
from hw.calibration.measurement import Measurement
from hw.calibration.reference_lines import Setup
from hw.calibration.rig_fit import Calibration, fit_rig, measure
from hw.camera.linearity import Linearity, linearity
from hw.camera.photo_set import PhotoSet
from hw.errors import CalibrationError
from render.arrays import Array
from render.scene import Scene, unchecked
from tests.hw.calibration.toy import BENDS, IMPERFECTIONS, PHOTOGRAPHED, taken, toy_model

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def camera_scene(scene: Scene) -> Scene:
    """Return the sensor with half the camera's resolution, for speed."""
    camera = unchecked(scene.camera, {"rows": 300, "columns": 180})
    return unchecked(scene, {"camera": camera})


def setup_of(scene: Scene) -> Setup:
    return Setup(scene, np.full(20, np.pi / 2), BENDS)


Outcome = tuple[Calibration, list[Measurement], Array]


@pytest.fixture(scope="module")
def outcome(camera_scene: Scene, table: MaterialTable) -> Outcome:
    """Photograph and fit."""
    sets, _, power = taken(camera_scene, IMPERFECTIONS)
    measurements = measure(setup_of(camera_scene), sets, 2.55)
    return fit_rig(camera_scene, toy_model(table), measurements), measurements, power


def test_the_true_material_is_found(outcome: Outcome) -> None:
    found, measurements, _ = outcome
    assert len(measurements) == 20
    values, truth = found.material, PHOTOGRAPHED
    inside = np.abs(values - truth) <= 1.96 * found.errors.material
    near = np.abs(values / truth - 1) < 0.1
    assert (inside | near)[:3].all(), (values, truth, found.errors.material)
    # Intervals that hold everything would be worth nothing.
    assert found.errors.material[0] / truth[0] < 0.1
    assert found.errors.material[2] / truth[2] < 0.1


def test_powers_gains_and_the_cameras_flaws_are_found(outcome: Outcome) -> None:
    found, _, power = outcome
    error = found.power / (power / power.mean()) - 1
    assert np.median(np.abs(error)) < 0.02
    # Fibers at the base of the bent pad show few points: their own intervals say so.
    assert (np.abs(error) < np.maximum(3 * found.errors.power, 0.04)).all()
    np.testing.assert_allclose(found.gain / found.gain[0], [1.0, 0.9, 0.8], rtol=0.02)
    assert found.vignetting == pytest.approx(0.15, abs=0.08)
    np.testing.assert_allclose(np.abs(found.tilt), np.abs(IMPERFECTIONS.tilt), atol=0.004)


def test_the_report_overlays_curves_and_says_what_cannot_be_separated(
    outcome: Outcome, camera_scene: Scene, tmp_path: Path
) -> None:
    found, measurements, _ = outcome
    linear = Linearity(0.004, 0.0, 1.0, 1.0, "none")
    result = {"date": "2026-01-31", "scene": "runs/mine/scene.toml"}
    result |= told(camera_scene, found, linear, None)
    text = render_report(setup_of(camera_scene), result, found, measurements)
    assert text.count("data:image/png;base64,") == 6
    assert "g and sigma_s cannot be separated" in text
    assert "Neither corrected nor confirmed by renders" in text
    assert "<code>tactilux train runs/mine/scene.toml</code>" in text.partition("Next</h2>")[2]
    (tmp_path / "report.html").write_text(text)


def test_a_linear_camera_may_be_calibrated_on(camera_scene: Scene) -> None:
    _, additive, _ = taken(camera_scene, replace(IMPERFECTIONS, noise=1.0))
    assert linearity(additive, 1.0).cause == "none"


def test_a_gamma_is_refused(camera_scene: Scene) -> None:
    _, additive, _ = taken(camera_scene, replace(IMPERFECTIONS, noise=0.2))
    assert additive.together is not None

    def encoded(photo: Array) -> Array:
        return 255 * np.sign(photo) * (np.abs(photo) / 255) ** (1 / 1.8)

    alone = {fiber: encoded(photo) for fiber, photo in additive.alone.items()}
    with pytest.raises(CalibrationError, match="gamma"):
        linearity(PhotoSet(alone, encoded(additive.together)), 0.2).require()


def test_a_sweep_without_all_fibers_together_is_refused(camera_scene: Scene) -> None:
    sets, _, _ = taken(camera_scene, IMPERFECTIONS)
    with pytest.raises(CalibrationError, match="no photograph of all fibers together"):
        linearity(sets[0], 2.55)


def test_a_dark_fiber_raises_one_clear_error(camera_scene: Scene, table: MaterialTable) -> None:
    sets, _, _ = taken(camera_scene, IMPERFECTIONS)
    sets[0].alone[4] = 0.0 * sets[0].alone[4]
    measurements = measure(setup_of(camera_scene), sets, 2.55)
    with pytest.raises(CalibrationError, match="fiber 4 lights too few points"):
        fit_rig(camera_scene, toy_model(table), measurements)
