"""On a clear pad whose skin has an albedo per channel the fit finds each of them.

The light is the toy of `tests.hw.calibration.test_clear_pad_fit`, for each channel with its albedo.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hw.calibration.calibration import calibrated_toml
from hw.calibration.line_model import LineModel, error_modes
from hw.calibration.log_ratio import LogRatios
from hw.calibration.material import material_space
from hw.calibration.material_correction import BendCorrection
from hw.calibration.material_table import fitted_table
from hw.calibration.measurement import Measurement
from hw.calibration.reference_lines import Setup, frame_positions
from hw.calibration.residuals import CalibrationResiduals
from hw.calibration.response import SkinColor, measured_response, skin_color
from hw.calibration.rig_fit import Calibration, fit_rig
from hw.errors import CalibrationError
from render.arrays import Array
from render.scene import Scene, load_scene, sources, unchecked
from tests.colored_skins import tinted_digit
from tests.hw.calibration.test_clear_pad_fit import GAIN, SPACE, toy
from tests.hw.calibration.test_response import TRUE as RESPONSE
from tests.hw.calibration.test_response import sweeps

TRUE = np.array([0.7, 0.3, 0.5, 0.15])
"""Albedos in red, green and blue, and the roughness."""


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tinted_digit(tmp_path_factory.mktemp("tinted"))


@pytest.fixture(scope="module")
def colored(path: Path) -> Scene:
    return load_scene(path)


@pytest.fixture(scope="module")
def model(colored: Scene) -> LineModel:
    materials = SPACE.sobol(SPACE.enough)
    drawn = np.stack([toy(material) for material in materials])[:, None, None].repeat(3, axis=2)
    table = fitted_table(SPACE, materials, drawn)
    nothing = np.zeros(table.coefficients.shape[1:])
    modes = error_modes(np.array([0.003]), 3, 3)
    return LineModel(material_space(colored), table, nothing, modes)


def photographs(model: LineModel, values: Array, seed: int) -> tuple[list[Measurement], Array]:
    """Return measurements of the flat pad under each lamp, and the lamps' true powers."""
    rng = np.random.default_rng(seed)
    power, found = np.exp(0.08 * rng.standard_normal(3)), []
    seen = model.space.seen(model.space.material(values))
    light = np.exp(np.stack([toy(material) for material in seen], axis=-1))
    for lamp in range(3):
        radius2 = rng.uniform(0, 1, len(light))
        clean = light * power[lamp] * GAIN * (1 - 0.15 * radius2)[:, None]
        counts = clean + 0.5 * rng.standard_normal(clean.shape)
        slope = clean * rng.uniform(-5, 5, (3, len(light), 1))
        used = (counts > 3).all(axis=1)
        found.append(Measurement(lamp, 0, counts, used, [0, 1, 2], 0.5, radius2, slope))
    return found, power / power.mean()


def fitted(scene: Scene, model: LineModel, values: Array, seed: int = 0) -> Calibration:
    return fit_rig(scene, model, photographs(model, values, seed)[0])


def test_each_channel_has_an_albedo_of_its_own_and_the_rest_in_common(colored: Scene) -> None:
    space = material_space(colored)
    assert space.names == ("albedo_red", "albedo_green", "albedo_blue", "roughness")
    np.testing.assert_allclose(space.values(space.of(colored)), [0.6, 0.25, 0.45, 0.1])
    other = space.material(TRUE)
    after = space.put_into(colored, other)
    assert after.coating.albedo == (0.7, 0.3, 0.5)
    np.testing.assert_allclose(space.of(after), other)
    np.testing.assert_allclose(space.seen(other)[:, 0], TRUE[:3])
    np.testing.assert_allclose(space.seen(other)[:, 1], 0.15**2)
    # Light is drawn and rendered for one albedo, and serves the plain sensor too.
    plain = Setup(load_scene("digit"), np.full(3, np.pi / 2), np.zeros(1))
    assert Setup(colored, plain.phi, plain.bends).one_albedo.key(1) == plain.key(1)


def test_behind_a_diffuser_one_albedo_is_asked_for() -> None:
    coating = unchecked(load_scene("finger20").coating, {"albedo": (0.7, 0.3, 0.5)})
    scene = unchecked(load_scene("finger20"), {"coating": coating})
    with pytest.raises(CalibrationError, match=r"differs by channel \(0.7, 0.3, 0.5\), allowed"):
        material_space(scene)


def test_all_albedos_and_the_powers_are_found(colored: Scene, model: LineModel) -> None:
    measurements, power = photographs(model, TRUE, 0)
    found = fit_rig(colored, model, measurements)
    np.testing.assert_allclose(model.space.values(found.material), TRUE, atol=0.03)
    np.testing.assert_allclose(found.power, power, rtol=0.01)
    np.testing.assert_allclose(found.gain, GAIN, rtol=0.1)
    assert (np.abs(found.gain / GAIN - 1) < 3 * found.errors.gain).all()


def test_intervals_hold_the_truth_about_as_often_as_they_say(
    colored: Scene, model: LineModel
) -> None:
    rng, held = np.random.default_rng(3), []
    for seed in range(10):
        values = rng.uniform([0.4, 0.15, 0.3, 0.05], [0.8, 0.5, 0.7, 0.25])
        intervals = np.array(fitted(colored, model, values, seed).intervals)
        held.append((intervals[:, 0] <= values) & (values <= intervals[:, 1]))
    # Of 40 intervals of 95 %, fewer than 34 come about once in 300 times.
    assert np.sum(held) >= 34


def test_derivatives_are_those_of_the_residuals(colored: Scene, model: LineModel) -> None:
    problem = CalibrationResiduals(model, photographs(model, TRUE, 0)[0], model.space.of(colored))
    x, step = problem.start(model.space.material(TRUE)), 1e-6 * problem.scale()
    numeric = [
        (problem.residuals(x + change) - problem.residuals(x - change)) / (2 * size)
        for change, size in zip(np.diag(step), step, strict=True)
    ]
    found = problem.jacobian(x)
    np.testing.assert_allclose(
        found, np.transpose(numeric), atol=1e-5 * np.abs(found).max(axis=0).min()
    )


def test_what_renders_leave_open_is_the_same_for_channels_of_one_albedo() -> None:
    rng, materials = np.random.default_rng(0), SPACE.sobol(8)
    place = np.stack([rng.uniform(-6, 6, 40), rng.uniform(1, 14, 40)], axis=-1)
    data = [
        [LogRatios(place, 0.05 * rng.standard_normal(40), np.full(40, 0.05**2))] for _ in materials
    ]
    correction = BendCorrection(data, materials, SPACE)
    one, other = SPACE.material(np.array([[0.2, 0.1], [0.8, 0.1]]))
    modes = correction.modes(np.stack([one, one, other]))
    assert modes.shape[1:] == (1, len(frame_positions()), 3)
    np.testing.assert_allclose(modes[..., 0], modes[..., 1], atol=1e-8)
    variance = (modes**2).sum(axis=0)
    alone = (correction.modes(other) ** 2).sum(axis=0)
    # Modes may leave out a hundredth of the variance, here of three channels together.
    assert variance[..., 2].sum() == pytest.approx(alone.sum(), rel=0.1)
    assert np.abs(modes[..., 2] - modes[..., 0]).max() > 0.1 * np.abs(modes).max()


def test_the_calibrated_scene_says_where_each_albedo_is_from(
    colored: Scene, model: LineModel, path: Path, tmp_path: Path
) -> None:
    found = fitted(colored, model, TRUE)
    after = tmp_path / "scene.toml"
    after.write_text(calibrated_toml(path.read_text(), colored, found, "2026-01-31"))
    np.testing.assert_allclose(load_scene(after).coating.albedo, found.material[:3], rtol=1e-5)
    assert sources(after)["coating.albedo"].count("calibrated 2026-01-31, 95 % interval") == 3


def test_the_response_of_the_leds_has_no_color_of_the_skin(
    colored: Scene, model: LineModel
) -> None:
    found = fitted(colored, model, TRUE)
    skin = skin_color(found, photographs(model, TRUE, 0)[0])
    light = np.exp(np.stack([toy(one) for one in model.space.seen(model.space.material(TRUE))]))
    light = light.mean(axis=1) / light.mean()
    assert (np.abs(skin.light / light - 1) < 3 * skin.error).all()
    camera = unchecked(colored.camera, {"rows": 100, "columns": 60})
    small = unchecked(colored, {"camera": camera})
    sets = sweeps(small, 0.0)
    for photos in sets:
        for fiber in photos.alone:
            photos.alone[fiber] *= skin.light
    told = measured_response(small, sets, SkinColor(skin.light, skin.error))
    np.testing.assert_allclose(told.matrix, RESPONSE, atol=0.005)
    known = np.hypot(skin.error, skin.error[1])[[0, 2]]
    np.testing.assert_allclose(told.of_skin, [known[0], 0.0, known[1]])
    np.testing.assert_allclose(told.interval(2.0)[1, 1], 1.0)
    low, high = told.interval(2.0)[2, 2]
    np.testing.assert_allclose([low, high], 0.5 * np.exp([-2 * known[1], 2 * known[1]]), rtol=0.02)
