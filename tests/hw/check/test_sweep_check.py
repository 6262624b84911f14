"""A sweep names every single fault of every fiber, and accuses no healthy one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hw.check.camera_response import channel_gains, measured_response
from hw.check.diagnosis import FiberState
from hw.check.prediction import PadPrediction
from hw.check.rig_tolerances import STARTS, rig_tolerances
from hw.check.sweep_check import check_sweep
from hw.errors import CaptureError
from render.arrays import Array

GAIN = np.array([2.0, 3.0, 1.5])
FINE = rig_tolerances(sweep=True, starts=STARTS, noise=np.array(0.045))


def seen(prediction: PadPrediction, power: Array | None = None, turn: Array | None = None) -> Array:
    phi = prediction.phi if turn is None else prediction.phi + turn
    light = prediction.unit(phi[:, None])[:, 0]
    lit = prediction.power if power is None else power
    return np.asarray(light[..., None] * lit[:, None, :] * GAIN)


def test_a_healthy_rig_is_healthy_whatever_the_gains(prediction: PadPrediction) -> None:
    diagnosis = check_sweep(prediction, seen(prediction), FINE)
    assert diagnosis.ok
    assert diagnosis.counts_error < 1e-9
    assert all(fiber.confidence > 0.9 for fiber in diagnosis.fibers)


@pytest.mark.parametrize("fiber", [0, 4, 9, 13, 19])
@pytest.mark.parametrize(
    ("factor", "state"), [(0.0, FiberState.DEAD), (0.5, FiberState.DIM), (0.7, FiberState.DIM)]
)
def test_a_weak_fiber_is_named(
    prediction: PadPrediction, fiber: int, factor: float, state: FiberState
) -> None:
    power = prediction.power.copy()
    power[fiber] *= factor
    diagnosis = check_sweep(prediction, seen(prediction, power), FINE)
    assert [(one.index, one.state) for one in diagnosis.faults] == [(fiber, state)]
    if state is FiberState.DIM:
        assert diagnosis.fibers[fiber].power == pytest.approx(factor, abs=0.03)


@pytest.mark.parametrize("fiber", [0, 9, 19])
def test_a_swapped_color_is_named(prediction: PadPrediction, fiber: int) -> None:
    power = prediction.power.copy()
    power[fiber] = np.roll(power[fiber], 1)
    diagnosis = check_sweep(prediction, seen(prediction, power), FINE)
    assert [(one.index, one.state) for one in diagnosis.faults] == [(fiber, FiberState.SWAPPED)]


@pytest.mark.parametrize("degrees", [-10.0, 10.0, 20.0])
@pytest.mark.parametrize("fiber", [2, 5, 10, 17])
def test_a_turned_fiber_is_named_with_its_angle(
    prediction: PadPrediction, fiber: int, degrees: float
) -> None:
    turn = np.zeros(20)
    turn[fiber] = np.radians(degrees)
    diagnosis = check_sweep(prediction, seen(prediction, turn=turn), FINE)
    assert [(one.index, one.state) for one in diagnosis.faults] == [(fiber, FiberState.MOVED)]
    turned = diagnosis.fibers[fiber].turned
    assert turned is not None
    assert np.degrees(turned) == pytest.approx(degrees, abs=1.5)


@pytest.mark.parametrize(("fiber", "degrees"), [(7, -10.0), (11, 10.0), (12, 10.0), (19, -10.0)])
def test_a_turn_is_named_though_the_model_errs_in_what_it_does_to_the_light(
    prediction: PadPrediction, fiber: int, degrees: float
) -> None:
    """These change least; an error of their change must not make them look healthy."""
    turn = np.zeros(20)
    turn[fiber] = np.radians(degrees)
    exact = seen(prediction, turn=turn)
    error = FINE.model_when_turned(turn)[fiber]
    assert error > 0.007
    for draw in range(6):
        colors = exact.copy()
        colors[fiber] *= 1 + error * np.random.default_rng(draw).choice([-1, 1], (15, 1))
        diagnosis = check_sweep(prediction, colors, FINE)
        assert [(one.index, one.state) for one in diagnosis.faults] == [(fiber, FiberState.MOVED)]


def test_dirt_before_some_sites_is_not_called_a_fault_of_a_fiber(prediction: PadPrediction) -> None:
    colors = seen(prediction)
    colors[6, ::2] *= 0.4
    diagnosis = check_sweep(prediction, colors, FINE)
    assert diagnosis.fibers[6].state is FiberState.UNCLEAR


def test_two_faults_are_both_named(prediction: PadPrediction) -> None:
    power = prediction.power.copy()
    power[3] = 0.0
    power[11] *= 0.5
    found = {
        one.index: one.state
        for one in check_sweep(prediction, seen(prediction, power), FINE).faults
    }
    assert found == {3: FiberState.DEAD, 11: FiberState.DIM}


def test_a_fiber_that_the_design_leaves_dark_is_not_judged(prediction: PadPrediction) -> None:
    power = prediction.power.copy()
    power[7] = 0.0
    dark = replace(prediction, power=power)
    diagnosis = check_sweep(dark, seen(dark), FINE)
    assert diagnosis.ok
    assert diagnosis.fibers[7].state is FiberState.OFF


def test_the_models_own_error_cancels_against_a_record(prediction: PadPrediction) -> None:
    error = np.exp(0.1 * np.random.default_rng(0).standard_normal((20, 15)))
    colors = seen(prediction) * error[..., None]
    assert not check_sweep(prediction, colors, FINE).ok
    assert check_sweep(prediction, colors, FINE, error).ok


def test_darkness_raises_one_clear_error(prediction: PadPrediction) -> None:
    with pytest.raises(CaptureError, match="lens cap"):
        check_sweep(prediction, np.zeros((20, 15, 3)), FINE)


@pytest.mark.parametrize("shape", [(19, 15, 3), (20, 14, 3), (20, 15), (0,)])
def test_another_shape_is_refused(prediction: PadPrediction, shape: tuple[int, ...]) -> None:
    with pytest.raises(CaptureError, match="shape"):
        check_sweep(prediction, np.ones(shape), FINE)


def test_values_that_are_not_finite_are_refused(prediction: PadPrediction) -> None:
    colors = seen(prediction)
    colors[0, 0, 0] = np.nan
    with pytest.raises(CaptureError, match="finite"):
        check_sweep(prediction, colors, FINE)


RESPONSE = np.array([[1.0, 0.06, 0.01], [0.08, 1.0, 0.05], [0.0, 0.07, 1.0]])
"""Of LED colors (rows) in channels (columns)."""


def mixed(prediction: PadPrediction, power: Array | None = None) -> Array:
    """Return a sweep through a camera whose channels see other colors too, with a little noise."""
    lit = prediction.power if power is None else power
    light = prediction.tinted(prediction.phi[:, None])[:, 0] * (lit @ RESPONSE)[:, None] * GAIN
    return np.asarray(light + 0.045 * np.random.default_rng(4).standard_normal(light.shape))


def test_the_response_is_measured_whatever_one_fiber_does(prediction: PadPrediction) -> None:
    assert not check_sweep(prediction, mixed(prediction), FINE).ok
    for factor, shift in ((1.0, 0), (0.0, 0), (1.0, 1)):
        power = prediction.power.copy()
        power[9] = factor * np.roll(power[9], shift)
        found = measured_response(prediction, mixed(prediction, power))
        np.testing.assert_allclose(found, RESPONSE, atol=0.01)


def test_a_color_of_few_fibers_that_is_swapped_is_no_leak(prediction: PadPrediction) -> None:
    power = np.zeros((20, 3))
    power[:3] = np.eye(3)
    few = replace(prediction, power=power)
    swapped = power.copy()
    swapped[2] = [1.0, 0.0, 0.0]
    found = measured_response(few, mixed(few, swapped))
    np.testing.assert_allclose(found[:2], RESPONSE[:2], atol=0.02)
    assert found[2].tolist() == [0.0, 0.0, 1.0]


@pytest.mark.parametrize("fiber", [0, 9, 19])
@pytest.mark.parametrize(
    ("factor", "shift", "state"),
    [(0.0, 0, FiberState.DEAD), (0.5, 0, FiberState.DIM), (1.0, 1, FiberState.SWAPPED)],
)
def test_faults_are_named_through_channels_that_see_other_colors(
    prediction: PadPrediction, fiber: int, factor: float, shift: int, state: FiberState
) -> None:
    power = prediction.power.copy()
    power[fiber] = factor * np.roll(power[fiber], shift)
    known = replace(prediction, response=RESPONSE)
    assert check_sweep(known, mixed(prediction), FINE).ok
    diagnosis = check_sweep(known, mixed(prediction, power), FINE)
    assert [(one.index, one.state) for one in diagnosis.faults] == [(fiber, state)]


def test_gains_ignore_dead_fibers(prediction: PadPrediction) -> None:
    colors = seen(prediction)
    colors[[0, 1, 2]] = 0.0
    np.testing.assert_allclose(channel_gains(prediction.alone, colors, prediction.own), GAIN)


def test_a_dim_lamp_that_is_alone_in_its_color_is_no_gain_of_its_channel() -> None:
    expected = np.ones((3, 4, 1)) * np.eye(3)[:, None, :] * [200.0, 150.0, 100.0]
    own = np.eye(3, dtype=np.bool_)
    colors = 0.9 * expected * np.array([1.0, 0.5, 1.0])[:, None, None]
    np.testing.assert_allclose(channel_gains(expected, colors, own, recorded=True), 0.9)
    # Nobody knows the gains of a camera that has seen no healthy rig.
    np.testing.assert_allclose(channel_gains(expected, colors, own), [0.9, 0.45, 0.9])


def fixed(prediction: PadPrediction) -> PadPrediction:
    """Return what is expected of lamps that cannot turn."""
    straight = prediction.unit(prediction.phi[:, None])
    return replace(prediction, table=np.repeat(straight, prediction.table.shape[1], axis=1))


def test_a_healthy_lamp_that_cannot_turn_is_not_accused_of_its_powers_drift(
    prediction: PadPrediction,
) -> None:
    rig = fixed(prediction)
    assert prediction.turns.all()
    assert not rig.turns.any()
    # Light so dim that noise hides what a site differs by, and a power that drifted far.
    dim = replace(rig, power=0.1 * rig.power)
    for fiber in range(20):
        rng = np.random.default_rng(fiber)
        power = dim.power * np.where(np.arange(20) == fiber, 1.12, 1.0)[:, None]
        colors = replace(dim, power=power).alone
        colors = colors + 0.045 * rng.standard_normal(colors.shape)
        assert check_sweep(dim, colors, FINE).ok


@pytest.mark.parametrize("fiber", [0, 9, 19])
def test_a_crooked_lamp_that_cannot_turn_is_unclear_and_its_seat_is_named(
    prediction: PadPrediction, fiber: int
) -> None:
    turn = np.zeros(20)
    turn[fiber] = np.radians(10.0)
    diagnosis = check_sweep(fixed(prediction), seen(prediction, turn=turn), FINE)
    assert [(one.index, one.state) for one in diagnosis.faults] == [(fiber, FiberState.UNCLEAR)]
    assert "sits straight" in diagnosis.faults[0].detail


def test_gains_of_channels_of_few_lamps_go_with_those_of_many() -> None:
    """Five lamps, three of them green: what the record says of the others must not change."""
    own = np.eye(3, dtype=np.bool_)[[0, 1, 2, 1, 1]]
    expected = np.ones((5, 4, 1)) * own[:, None, :]
    colors = expected * np.array([1.0, 0.78, 1.05, 0.79, 0.96])[:, None, None]
    gain = channel_gains(expected, colors, own, recorded=True)
    ratio = (colors / gain).max(axis=2, keepdims=True)
    np.testing.assert_allclose(channel_gains(expected * ratio, colors, own, recorded=True), gain)
