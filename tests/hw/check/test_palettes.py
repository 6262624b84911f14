"""Sweeps and images of rigs with any LEDs: faults are named, healthy rigs are left alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hw.check.camera_response import measured_response
from hw.check.commission import commission, load_record
from hw.check.diagnosis import FiberState
from hw.check.image_check import check_image
from hw.check.prediction import PadPrediction
from hw.check.rig_tolerances import STARTS, rig_tolerances
from hw.check.sweep_check import BY_BRIGHTNESS, check_sweep, swapped_powers
from render.arrays import Array
from render.scene import load_scene
from tests.hw.palettes import RESPONSES, matrix

FINE = rig_tolerances(sweep=True, starts=STARTS, noise=np.array(0.045))
PLAIN = rig_tolerances(sweep=True, starts=0, noise=np.array(0.045))
WHITE, INFRARED = "white, gray camera", "white and infrared, gray camera"
AMBER = "white and amber, color camera"
each = pytest.mark.parametrize("name", RESPONSES)
several = pytest.mark.parametrize("name", [name for name in RESPONSES if name != WHITE])


def expected(prediction: PadPrediction, name: str) -> PadPrediction:
    """Return what is expected of a rig whose fibers shine in the palette's colors in turn."""
    response = matrix(name)
    power = np.eye(len(response))[np.arange(20) % len(response)]
    return replace(prediction, power=power, response=response)


def seen(rig: PadPrediction, power: Array | None = None, seed: int = 0) -> Array:
    """Return a sweep of LEDs a little off the response, through a camera with gains and noise."""
    rng = np.random.default_rng(seed)
    strength = rng.uniform(0.85, 1.15, rig.response.shape)
    gain = rng.uniform(0.5, 1.5, len(rig.response.T))
    start = np.random.default_rng([seed, 0 if power is None else 1])
    lit = (rig.power if power is None else power) * np.exp(0.02 * start.standard_normal((20, 1)))
    light = replace(rig, power=lit, response=rig.response * strength).alone * gain
    return np.asarray(light + 0.045 * start.standard_normal(light.shape))


@each
@pytest.mark.parametrize("seed", range(4))
def test_a_healthy_rig_is_healthy_with_and_without_its_record(
    prediction: PadPrediction, name: str, seed: int, tmp_path: Path
) -> None:
    rig = expected(prediction, name)
    first, later = seen(rig, seed=seed), seen(rig, rig.power, seed)
    plain = replace(rig, response=measured_response(rig, first))
    assert check_sweep(plain, first, PLAIN).ok
    scene = load_scene("finger20")
    commission(rig, first, scene, 0.0).save(tmp_path / "rig.npz")
    record = load_record(tmp_path / "rig.npz")
    record.check_fits(rig, scene, 0.0)
    assert check_sweep(replace(rig, response=record.response), later, FINE, record.ratio).ok


@each
@pytest.mark.parametrize("fiber", [0, 4, 13])
@pytest.mark.parametrize(("factor", "state"), [(0.0, FiberState.DEAD), (0.7, FiberState.DIM)])
def test_a_weak_fiber_is_named(
    prediction: PadPrediction, name: str, fiber: int, factor: float, state: FiberState
) -> None:
    rig = expected(prediction, name)
    record = commission(rig, seen(rig), load_scene("finger20"), 0.0)
    power = rig.power.copy()
    power[fiber] *= factor
    known = replace(rig, response=record.response)
    found = check_sweep(known, seen(rig, power), FINE, record.ratio)
    assert [(one.index, one.state) for one in found.faults] == [(fiber, state)]


@several
@pytest.mark.parametrize("fiber", [0, 4, 13])
def test_a_wrong_color_is_named(prediction: PadPrediction, name: str, fiber: int) -> None:
    rig = expected(prediction, name)
    record = commission(rig, seen(rig), load_scene("finger20"), 0.0)
    power = rig.power.copy()
    power[fiber] = np.roll(power[fiber], 1)
    known = replace(rig, response=record.response)
    found = check_sweep(known, seen(rig, power), FINE, record.ratio)
    assert [(one.index, one.state) for one in found.faults] == [(fiber, FiberState.SWAPPED)]
    assert found.faults[0].detail == (BY_BRIGHTNESS if name == INFRARED else "")


@pytest.mark.parametrize("name", RESPONSES)
def test_two_exchanged_lamps_are_no_healthy_rig(prediction: PadPrediction, name: str) -> None:
    rig = expected(prediction, name)
    colors = seen(rig)
    record = commission(rig, colors, load_scene("finger20"), 0.0)
    known = replace(rig, response=record.response)
    colors = seen(rig, rig.power)
    colors[[2, 10]] = colors[[10, 2]]
    found = check_sweep(known, colors, FINE, record.ratio)
    assert {one.index for one in found.faults} == {2, 10}


@each
def test_one_image_names_a_dead_fiber(prediction: PadPrediction, name: str) -> None:
    rig = expected(prediction, name)
    image = rig_tolerances(sweep=False, starts=STARTS, noise=np.array(0.045))
    whole = rig.together
    assert check_image(rig, whole, image).ok
    found = check_image(rig, whole - rig.alone[4], image)
    assert [(one.index, one.state) for one in found.faults] == [(4, FiberState.DEAD)]


@pytest.mark.parametrize("seed", range(3))
def test_the_response_is_measured_as_far_as_gains_leave_it(
    prediction: PadPrediction, seed: int
) -> None:
    """A camera of one channel tells how bright each LED is over the others, but for one factor."""
    rig = expected(prediction, INFRARED)
    true = replace(rig, response=np.array([[1.0], [0.55]]))
    found = measured_response(rig, seen(true, seed=seed))
    strength = np.random.default_rng(seed).uniform(0.85, 1.15, (2, 1))
    relative = (true.response * strength)[1, 0] / strength[0, 0]
    assert found[1, 0] / found[0, 0] == pytest.approx(relative, rel=0.04)


def test_colors_that_look_the_same_cannot_be_swapped() -> None:
    power = np.array([1.0, 0.0])
    assert len(swapped_powers(power, np.array([[1.0], [0.4]]))) == 1
    assert len(swapped_powers(power, np.array([[1.0], [0.97]]))) == 0
    assert len(swapped_powers(np.ones(1), np.ones((1, 3)))) == 0


def test_a_color_camera_names_a_swap_by_its_hue(prediction: PadPrediction) -> None:
    rig = expected(prediction, AMBER)
    power = rig.power.copy()
    # As bright as the design in red, and another in the other channels.
    power[2] = [0.0, 0.9]
    found = check_sweep(rig, replace(rig, power=power).alone, FINE)
    assert [(one.index, one.state) for one in found.faults] == [(2, FiberState.SWAPPED)]
