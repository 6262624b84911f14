"""On a clear pad of few lamps the fit finds the skin, the lit faces and the lamps' powers.

The light is a toy with a known, simple physics, as in `tests.hw.calibration.toy`.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable

import numpy as np
import pytest

from hw.calibration.calibration import calibrated_toml
from hw.calibration.line_model import LineModel
from hw.calibration.log_ratio import field_modes
from hw.calibration.material import material_space
from hw.calibration.material_table import fitted_table
from hw.calibration.measurement import Measurement
from hw.calibration.reference_lines import frame_positions
from hw.calibration.rig_fit import Calibration, fit_rig
from hw.errors import CalibrationError
from render.arrays import Array
from render.scene import load_scene, scene_text

SCENE = load_scene("digit")
SPACE = material_space(SCENE)
TRUE = SPACE.material(np.array([0.6, 0.18]))
GAIN = np.array([2.0, 1.7, 1.4]) * 1e5


def toy(material: Array) -> Array:
    """Return log light ``(point,)``: a bright skin lights what is far, rough faces blur."""
    albedo, roughness = SPACE.values(material)
    across, along = frame_positions().T
    width = 2.0 + 30.0 * roughness**2 + 0.25 * along
    return np.asarray(
        np.log(albedo)
        - np.log(1 + (across / width) ** 2)
        - (2.0 - 1.2 * albedo) * np.log(along + 2.0)
        - 5.0
    )


def model(of: Callable[[Array], Array] = toy) -> LineModel:
    materials = SPACE.sobol(SPACE.enough)
    drawn = np.stack([of(material) for material in materials])[:, None, None].repeat(3, axis=2)
    table = fitted_table(SPACE, materials, drawn)
    nothing = np.zeros(table.coefficients.shape[1:])
    return LineModel(SPACE, table, nothing, field_modes(np.array([0.003]), 3))


def photographs(true: Array, seed: int, lamps: int = 3) -> tuple[list[Measurement], Array]:
    """Return measurements of the flat pad under each lamp, and the lamps' true powers."""
    rng = np.random.default_rng(seed)
    power, found = np.exp(0.08 * rng.standard_normal(3)), []
    for lamp in range(lamps):
        light = np.exp(toy(true))
        radius2 = rng.uniform(0, 1, light.shape)
        clean = light[:, None] * power[lamp] * GAIN * (1 - 0.15 * radius2)[:, None]
        counts = clean + 0.5 * rng.standard_normal(clean.shape)
        slope = clean * rng.uniform(-5, 5, (3, len(light), 1))
        used = (counts > 3).all(axis=1)
        found.append(Measurement(lamp, 0, counts, used, [0, 1, 2], 0.5, radius2, slope))
    return found, power


def fitted(true: Array, seed: int = 0) -> tuple[Calibration, Array]:
    measurements, power = photographs(true, seed)
    return fit_rig(SCENE, model(), measurements), power / power.mean()


def test_skin_faces_and_powers_are_found() -> None:
    found, power = fitted(TRUE)
    np.testing.assert_allclose(SPACE.values(found.material), [0.6, 0.18], atol=0.02)
    assert (np.abs(found.material - TRUE) < 3 * found.errors.material).all()
    np.testing.assert_allclose(found.power, power, rtol=0.01)
    assert found.vignetting == pytest.approx(0.15, abs=0.02)


def test_intervals_hold_the_truth_about_as_often_as_they_say() -> None:
    rng = np.random.default_rng(3)
    held = []
    for seed in range(20):
        true = rng.uniform([0.3, 0.02], [0.7, 0.25])
        found, _ = fitted(SPACE.material(true), seed)
        held.append([low <= value <= high for value, (low, high) in zip(true, found.intervals,
                                                                        strict=True)])  # fmt: skip
    # Of 40 intervals of 95 %, fewer than 34 come about once in 300 times.
    assert np.sum(held) >= 34


def test_what_the_light_does_not_show_stays_what_the_scene_says() -> None:
    measurements, _ = photographs(TRUE, 0)
    found = fit_rig(SCENE, model(of=lambda _: toy(TRUE)), measurements)
    np.testing.assert_allclose(found.material, SPACE.of(SCENE), atol=1e-3)
    # Of the roughness 0.1, known to 0.1, the square is fitted.
    np.testing.assert_allclose(found.errors.material, [0.2, 0.2**2 - 0.1**2], rtol=0.01)


def test_fewer_photographs_than_lamps_are_refused() -> None:
    measurements, _ = photographs(TRUE, 0, lamps=2)
    said = "2 fibers were photographed, allowed: at least 3; .* a design that lights as many"
    with pytest.raises(CalibrationError, match=said):
        fit_rig(SCENE, model(), measurements)


def test_the_calibrated_scene_says_where_its_values_are_from() -> None:
    found, _ = fitted(TRUE)
    raw = tomllib.loads(calibrated_toml(scene_text("digit"), SCENE, found, "2026-01-31"))
    assert raw["coating"]["albedo"]["value"] == pytest.approx(found.material[0], rel=1e-5)
    for entry in (raw["coating"]["albedo"], raw["pad"]["roughness"]):
        assert entry["source"].startswith("calibrated 2026-01-31, 95 % interval ")
        assert entry["source"].endswith("; weighed with the value before")
    # Rows of lamps are as they were.
    assert raw["rows"] == tomllib.loads(scene_text("digit"))["rows"]
