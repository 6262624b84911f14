"""The fit finds material, powers, gains, tilt and vignetting, and knows how sure it is."""

from __future__ import annotations

import numpy as np
import pytest

from hw.calibration.material_table import MaterialTable
from hw.calibration.measurement import Measurement
from hw.calibration.residuals import CalibrationResiduals
from hw.calibration.rig_fit import Calibration, fit_rig
from hw.errors import CalibrationError
from render.arrays import Array
from render.scene import Scene
from tests.hw.calibration.toy import GAIN, TRUE, photographs, toy_model
from tests.long import LONG


def fitted(
    scene: Scene, table: MaterialTable, measurements: list[Measurement], discrepancy: float = 0.003
) -> Calibration:
    start = np.array([1.0, 0.005, np.radians(15.0), 0.1])
    model = toy_model(table, np.hypot(discrepancy, table.scatter()))
    return fit_rig(scene, model, measurements, start)


@pytest.fixture(scope="module")
def usual(scene: Scene, table: MaterialTable) -> tuple[Calibration, Array]:
    """Return the fit to the photographs of seed 0 with the usual noise; true powers."""
    measurements, power = photographs(scene)
    return fitted(scene, table, measurements), power


def test_material_powers_and_camera_are_found(usual: tuple[Calibration, Array]) -> None:
    found, power = usual
    truth, values, se = TRUE, found.material, found.errors.material
    assert (np.abs(values - truth) < 3 * se).all()
    assert found.material[0] == pytest.approx(1.2, rel=0.05)
    assert found.material[2] == pytest.approx(TRUE[2], rel=0.05)
    np.testing.assert_allclose(found.power, power / power.mean(), rtol=0.02)
    np.testing.assert_allclose(found.gain / GAIN, found.gain[0] / GAIN[0], rtol=0.01)
    np.testing.assert_allclose(found.tilt, [0.004, -0.003, 0.006], atol=0.001)
    assert found.vignetting == pytest.approx(0.15, abs=0.03)


@pytest.mark.slow
def test_intervals_hold_the_truth_about_as_often_as_they_say(
    scene: Scene, table: MaterialTable, usual: tuple[Calibration, Array]
) -> None:
    held = []
    for found in (
        usual[0],
        *(fitted(scene, table, photographs(scene, s)[0]) for s in range(1, 12)),
    ):
        z = (found.material - TRUE) / found.errors.material
        held.append(np.abs(z) < 1.96)
    # 24 or 48 intervals of 95 %: fewer than 18 or 40 would come about once in 10^4 times.
    assert np.sum(held) >= (40 if LONG else 18)


def test_more_noise_gives_wider_intervals(
    scene: Scene, table: MaterialTable, usual: tuple[Calibration, Array]
) -> None:
    loud = fitted(scene, table, photographs(scene, noise=5.0)[0]).errors
    # The roughness is considered, not fitted.
    assert (loud.material > usual[0].errors.material)[:3].all()


def test_a_model_that_is_less_sure_gives_wider_intervals(
    scene: Scene, table: MaterialTable, usual: tuple[Calibration, Array]
) -> None:
    unsure = fitted(scene, table, photographs(scene)[0], discrepancy=0.05).errors
    assert (unsure.material > usual[0].errors.material)[:3].all()


def test_a_roughness_other_than_the_scenes_is_within_the_intervals(
    scene: Scene, table: MaterialTable
) -> None:
    rougher = np.array([*TRUE[:3], 0.12])
    found = fitted(scene, table, photographs(scene, true=rougher)[0])
    z = (found.material - rougher) / found.errors.material
    assert np.abs(z).max() < 3
    assert found.errors.parts["known"][:3].min() > 0


@pytest.mark.parametrize(("declared", "held"), [(0.0, 0.03), (0.1, 0.1), (0.5, 0.25)])
def test_the_roughness_is_held_within_the_range_that_is_known(
    scene: Scene, table: MaterialTable, declared: float, held: float
) -> None:
    before = np.array([1.0, 0.005, np.radians(15.0), declared])
    problem = CalibrationResiduals(toy_model(table, table.scatter()), photographs(scene)[0], before)
    x = problem.start(np.array([1.0, 0.005, np.radians(15.0), held]))
    assert problem.residuals(x)[-1] == pytest.approx(0.0)


def test_powers_have_mean_1(usual: tuple[Calibration, Array]) -> None:
    assert np.mean(usual[0].power) == pytest.approx(1.0)


def test_too_few_photographs_are_refused(scene: Scene, table: MaterialTable) -> None:
    with pytest.raises(CalibrationError, match="at least 4"):
        fitted(scene, table, photographs(scene, fibers=3)[0])


def test_a_material_beyond_the_range_raises_one_clear_error(
    scene: Scene, table: MaterialTable
) -> None:
    outside = np.array([5.0, 0.02, np.radians(17.0), 0.1])
    with pytest.raises(CalibrationError, match="beyond the range"):
        fitted(scene, table, photographs(scene, true=outside)[0]).require_known()


def test_derivatives_are_those_of_the_residuals(scene: Scene, table: MaterialTable) -> None:
    problem = CalibrationResiduals(toy_model(table, 0.01), photographs(scene)[0], TRUE)
    x = problem.start(TRUE)
    x[4:8] = [0.002, -0.001, 0.003, 0.1]
    exact = problem.jacobian(x)
    step = 1e-4 * problem.scale()
    for index in range(len(x)):
        away = np.zeros(len(x))
        away[index] = step[index]
        slope = (problem.residuals(x + away) - problem.residuals(x - away)) / (2 * step[index])
        np.testing.assert_allclose(exact[:, index], slope, atol=1e-4 * np.abs(slope).max())
