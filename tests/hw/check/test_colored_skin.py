"""The check of a rig whose skin has an albedo per channel."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hw.check.commission import commission, load_record
from hw.check.diagnosis import FiberState
from hw.check.image_check import check_image
from hw.check.prediction import PadPrediction, predict
from hw.check.rig_tolerances import rig_tolerances
from hw.check.sweep_check import check_sweep
from hw.errors import CaptureError
from surrogate.preview_model import preview_checker
from surrogate.runtime import Checker
from tests.colored_skins import skin_of

TINTS = np.array([1.0, 0.6, 0.8])


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Checker:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        return preview_checker(skin_of(), coarse=True)


def test_what_is_expected_is_the_models_background(model: Checker) -> None:
    phi, power = np.array([1.1, 1.7]), np.array([[0.3, 0.0, 0.2], [0.0, 0.25, 0.1]])
    found = predict(model, phi, power, 0.0)
    assert found.table.shape[-1] == 3
    whole = model.run(phi[None], power[None], np.zeros(1))["background"][0, 0]
    assert 0.0 < whole.max() < 250.0
    np.testing.assert_allclose(found.together, whole, rtol=0.01)


def colored(prediction: PadPrediction) -> PadPrediction:
    """Return the prediction with a table by channel."""
    return replace(prediction, table=prediction.table[..., None] * TINTS)


def test_channels_of_the_same_light_are_expected_as_one(prediction: PadPrediction) -> None:
    alike = replace(prediction, table=np.repeat(prediction.table[..., None], 3, axis=-1))
    np.testing.assert_allclose(alike.alone, prediction.alone)
    photo = prediction.together - 0.5 * prediction.alone[4]
    fine = rig_tolerances(sweep=False, starts=0, noise=0.1)
    one, other = (check_image(each, photo, fine) for each in (prediction, alike))
    assert [fiber.state for fiber in one.fibers] == [fiber.state for fiber in other.fibers]
    assert one.counts_error == pytest.approx(other.counts_error)


def test_a_healthy_rig_is_well_and_a_dead_fiber_is_found(prediction: PadPrediction) -> None:
    expected = colored(prediction)
    sweep = rig_tolerances(sweep=True, starts=0, noise=0.1)
    lights = expected.alone.copy()
    assert check_sweep(expected, lights, sweep).ok
    scene = skin_of()
    commission(expected, lights, scene, 0.0).check_fits(expected, scene, 0.0)
    lights[7] = 0.0
    found = check_sweep(expected, lights, sweep)
    assert [fiber.index for fiber in found.fibers if fiber.state != "ok"] == [7]
    photo = check_image(
        expected, lights.sum(axis=0), rig_tolerances(sweep=False, starts=0, noise=0.1)
    )
    assert [fiber.index for fiber in photo.fibers if fiber.state != "ok"] == [7]


def test_what_channels_see_of_other_colors_is_told_apart_from_the_skins_color(
    prediction: PadPrediction,
) -> None:
    response = np.array([[1.0, 0.08, 0.02], [0.05, 1.0, 0.07], [0.01, 0.06, 1.0]])
    expected = replace(colored(prediction), response=response)
    record = commission(colored(prediction), 2.0 * expected.alone, skin_of(), 0.0)
    np.testing.assert_allclose(record.response, response, atol=0.01)
    np.testing.assert_allclose(record.ratio, 1.0, atol=0.02)


@pytest.fixture
def mixed(prediction: PadPrediction) -> PadPrediction:
    """Return the expected light of fibers of which eight shine in two colors."""
    power = prediction.power.copy()
    power[12:] += 0.5 * np.roll(power[12:], 1, axis=1)
    return replace(colored(prediction), power=power)


FINE = rig_tolerances(sweep=True, starts=4, noise=np.array(0.05))


def test_a_record_holds_what_the_model_errs_by_in_each_channel(
    mixed: PadPrediction, tmp_path: Path
) -> None:
    error = np.exp(0.03 * np.random.default_rng(3).standard_normal(mixed.alone.shape))
    lights = mixed.alone * error
    record = commission(mixed, lights, skin_of(), 0.0)
    record.save(tmp_path / "rig.npz")
    kept = load_record(tmp_path / "rig.npz")
    kept.check_fits(mixed, skin_of(), 0.0)
    known = replace(mixed, response=kept.response)
    assert check_sweep(known, lights, FINE, kept.ratio).ok
    alike = np.broadcast_to(kept.ratio.mean(axis=-1, keepdims=True), kept.ratio.shape)
    assert not check_sweep(known, lights, FINE, alike).ok


def test_a_skin_of_other_albedos_is_no_fault_though_other_channels_see_it_otherwise(
    prediction: PadPrediction,
) -> None:
    """Light of a channel falls off otherwise where its albedo is not the scene's."""
    leak = np.array([[1.0, 0.08, 0.05], [0.05, 1.0, 0.07], [0.06, 0.08, 1.0]])
    expected = colored(prediction)
    sites = np.linspace(-1.0, 1.0, expected.cells[1])[:, None]
    lights = replace(expected, response=leak).alone * np.exp(sites * np.array([0.4, 0.0, -0.4]))
    record = commission(expected, lights, skin_of(), 0.0)
    known = replace(expected, response=record.response)
    assert check_sweep(known, lights, FINE, record.ratio).ok
    lights[3] *= 0.5
    found = check_sweep(known, lights, FINE, record.ratio)
    assert [(one.index, one.state) for one in found.faults] == [(3, FiberState.DIM)]


@pytest.mark.parametrize("fiber", [1, 5, 14])
def test_a_color_in_which_no_record_holds_the_fiber_is_still_named_wrong(
    mixed: PadPrediction, fiber: int
) -> None:
    error = np.exp(0.03 * np.random.default_rng(4).standard_normal(mixed.alone.shape))
    record = commission(mixed, mixed.alone * error, skin_of(), 0.0)
    wrong = mixed.power.copy()
    wrong[fiber] = np.roll(wrong[fiber], 1)
    lights = replace(mixed, power=wrong).alone * error
    found = check_sweep(replace(mixed, response=record.response), lights, FINE, record.ratio)
    assert [(one.index, one.state) for one in found.faults] == [(fiber, FiberState.SWAPPED)]


def test_powers_of_a_fibers_leds_that_drift_apart_are_no_turn(mixed: PadPrediction) -> None:
    record = commission(mixed, mixed.alone, skin_of(), 0.0)
    drift = np.exp(0.03 * np.random.default_rng(5).standard_normal(mixed.power.shape))
    later = replace(mixed, power=mixed.power * drift).alone
    assert check_sweep(mixed, later, FINE, record.ratio).ok


def test_a_record_of_one_light_in_all_channels_raises_one_clear_error(
    prediction: PadPrediction,
) -> None:
    scene = skin_of()
    record = commission(prediction, prediction.alone, scene, 0.0)
    with pytest.raises(CaptureError, match="albedo makes it differ by channel: make a new one"):
        record.check_fits(colored(prediction), scene, 0.0)
