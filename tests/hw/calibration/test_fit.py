"""The fit finds material, powers, gains, tilt and vignetting, and knows how sure it is."""

from __future__ import annotations

import numpy as np
import pytest

from hw.calibration.fit import Calibration, calibrate, require_known
from hw.calibration.material import HIGH, LOW, Material
from hw.calibration.material_table import MaterialTable
from hw.calibration.measurement import Measurement
from hw.calibration.model_error import field_modes
from hw.calibration.residuals import CalibrationResiduals
from hw.errors import CalibrationError
from render.arrays import Array
from render.scene.schema import Scene
from tests.hw.calibration.conftest import toy_log_light

TRUE = Material(1.2, 0.02, np.radians(17.0), 0.1)
GAIN = np.array([2.0, 1.7, 1.4]) * 1e5


def photographs(
    scene: Scene, seed: int = 0, noise: float = 0.5, fibers: int = 20, true: Material = TRUE
) -> tuple[list[Measurement], Array]:
    """Return measurements of the toy, every other fiber flat and the others bent; true powers."""
    rng = np.random.default_rng(seed)
    power = np.exp(0.08 * rng.standard_normal(20))
    light = toy_log_light(scene, true.array())
    found = []
    for fiber in range(fibers):
        bend = fiber % 2
        own = np.exp(light[bend, fiber])
        radius2 = rng.uniform(0, 1, own.shape)
        clean = own[:, None] * power[fiber] * GAIN * (1 - 0.15 * radius2)[:, None]
        counts = clean + noise * rng.standard_normal(clean.shape)
        used = np.isfinite(counts).all(axis=1) & (counts > 3).all(axis=1)
        slope = np.where(used[:, None], clean, 0.0) * rng.uniform(-5, 5, (3, len(own), 1))
        tilt = np.array([0.004, -0.003, 0.006])
        counts = counts - np.einsum("tpc,t->pc", slope, tilt)
        found.append(Measurement(fiber, bend, counts, used, [0, 1, 2], noise, radius2, slope))
    return found, power


def fitted(
    table: MaterialTable, measurements: list[Measurement], discrepancy: float = 0.003
) -> Calibration:
    none = np.zeros(table.coefficients.shape[1:])
    start = Material(1.0, 0.005, np.radians(15.0), 0.1)
    modes = field_modes(np.hypot(discrepancy, table.scatter()), 20)
    return calibrate(table, none, modes, measurements, start, TRUE.roughness)


@pytest.fixture(scope="module")
def usual(scene: Scene, table: MaterialTable) -> tuple[Calibration, Array]:
    """Return the fit to the photographs of seed 0 with the usual noise; true powers."""
    measurements, power = photographs(scene)
    return fitted(table, measurements), power


def test_material_powers_and_camera_are_found(usual: tuple[Calibration, Array]) -> None:
    found, power = usual
    truth, values, se = TRUE.array(), found.material.array(), found.intervals.material
    assert (np.abs(values - truth) < 3 * se).all()
    assert found.material.reduced_scattering == pytest.approx(1.2, rel=0.05)
    assert found.material.sigma_v == pytest.approx(TRUE.sigma_v, rel=0.05)
    np.testing.assert_allclose(found.power, power / power.mean(), rtol=0.02)
    np.testing.assert_allclose(found.gain / GAIN, found.gain[0] / GAIN[0], rtol=0.01)
    np.testing.assert_allclose(found.tilt, [0.004, -0.003, 0.006], atol=0.001)
    assert found.vignetting == pytest.approx(0.15, abs=0.03)


def test_intervals_hold_the_truth_about_as_often_as_they_say(
    scene: Scene, table: MaterialTable, usual: tuple[Calibration, Array]
) -> None:
    held = []
    for found in (usual[0], *(fitted(table, photographs(scene, s)[0]) for s in range(1, 12))):
        z = (found.material.array() - TRUE.array()) / found.intervals.material
        held.append(np.abs(z) < 1.96)
    # 48 intervals of 95 %: fewer than 40 would come about once in 10^4 times.
    assert np.sum(held) >= 40


def test_more_noise_gives_wider_intervals(
    scene: Scene, table: MaterialTable, usual: tuple[Calibration, Array]
) -> None:
    loud = fitted(table, photographs(scene, noise=5.0)[0]).intervals
    # The roughness is considered, not fitted.
    assert (loud.material > usual[0].intervals.material)[:3].all()


def test_a_model_that_is_less_sure_gives_wider_intervals(
    scene: Scene, table: MaterialTable, usual: tuple[Calibration, Array]
) -> None:
    unsure = fitted(table, photographs(scene)[0], discrepancy=0.05).intervals
    assert (unsure.material > usual[0].intervals.material)[:3].all()


def test_a_roughness_other_than_the_scenes_is_within_the_intervals(
    scene: Scene, table: MaterialTable
) -> None:
    rougher = Material(TRUE.reduced_scattering, TRUE.absorption, TRUE.sigma_v, 0.12)
    found = fitted(table, photographs(scene, true=rougher)[0])
    z = (found.material.array() - rougher.array()) / found.intervals.material
    assert np.abs(z).max() < 3
    assert found.intervals.parts["known"][:3].min() > 0


@pytest.mark.parametrize(("declared", "held"), [(0.0, LOW[3]), (0.1, 0.1), (0.5, HIGH[3])])
def test_the_roughness_is_held_within_the_range_that_is_known(
    scene: Scene, table: MaterialTable, declared: float, held: float
) -> None:
    none = np.zeros(table.coefficients.shape[1:])
    modes = field_modes(table.scatter(), 20)
    problem = CalibrationResiduals(table, none, modes, photographs(scene)[0], declared)
    x = problem.start(Material(1.0, 0.005, np.radians(15.0), held))
    assert problem.residuals(x)[-1] == pytest.approx(0.0)


def test_powers_have_mean_1(usual: tuple[Calibration, Array]) -> None:
    assert np.mean(usual[0].power) == pytest.approx(1.0)


def test_too_few_photographs_are_refused(scene: Scene, table: MaterialTable) -> None:
    with pytest.raises(CalibrationError, match="at least 4"):
        fitted(table, photographs(scene, fibers=3)[0])


def test_a_material_beyond_the_range_is_told(scene: Scene, table: MaterialTable) -> None:
    outside = Material(5.0, 0.02, np.radians(17.0), 0.1)
    with pytest.raises(CalibrationError, match="beyond the range"):
        require_known(fitted(table, photographs(scene, true=outside)[0]))


def test_derivatives_are_those_of_the_residuals(scene: Scene, table: MaterialTable) -> None:
    none = np.zeros(table.coefficients.shape[1:])
    modes = field_modes(np.full(2, 0.01), 20)
    problem = CalibrationResiduals(table, none, modes, photographs(scene)[0], TRUE.roughness)
    x = problem.start(TRUE)
    x[4:8] = [0.002, -0.001, 0.003, 0.1]
    exact = problem.jacobian(x)
    step = 1e-4 * problem.scale()
    for index in range(len(x)):
        away = np.zeros(len(x))
        away[index] = step[index]
        slope = (problem.residuals(x + away) - problem.residuals(x - away)) / (2 * step[index])
        np.testing.assert_allclose(exact[:, index], slope, atol=1e-4 * np.abs(slope).max())
