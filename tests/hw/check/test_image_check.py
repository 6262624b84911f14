"""One image of all fibers shows what is large: dead, dim and wrongly colored fibers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hw.check.diagnosis import FiberState
from hw.check.image_check import check_image
from hw.check.prediction import PadPrediction
from hw.check.rig_tolerances import STARTS, rig_tolerances
from hw.errors import CaptureError

FINE = rig_tolerances(sweep=False, starts=STARTS, noise=np.array(0.045))


def test_a_healthy_image_is_healthy_at_any_exposure(prediction: PadPrediction) -> None:
    for gain in (0.3, 1.0, 4.0):
        assert check_image(prediction, gain * prediction.together, FINE).ok


@pytest.mark.parametrize("fiber", [1, 5, 9, 16])
def test_a_dead_fiber_is_named(prediction: PadPrediction, fiber: int) -> None:
    colors = prediction.together - prediction.alone[fiber]
    diagnosis = check_image(prediction, colors, FINE)
    assert [(one.index, one.state) for one in diagnosis.faults] == [(fiber, FiberState.DEAD)]


@pytest.mark.parametrize("fiber", [3, 9])
def test_a_swapped_color_is_named(prediction: PadPrediction, fiber: int) -> None:
    own = prediction.alone[fiber]
    colors = prediction.together - own + np.roll(own, 1, axis=-1)
    diagnosis = check_image(prediction, colors, FINE)
    assert [(one.index, one.state) for one in diagnosis.faults] == [(fiber, FiberState.SWAPPED)]


def test_what_no_single_fault_explains_is_unclear(prediction: PadPrediction) -> None:
    colors = prediction.together * np.where(np.arange(15) % 2, 1.0, 0.6)[:, None]
    diagnosis = check_image(prediction, colors, FINE)
    assert not diagnosis.ok
    assert {one.state for one in diagnosis.faults} == {FiberState.UNCLEAR}


def test_darkness_raises_one_clear_error(prediction: PadPrediction) -> None:
    with pytest.raises(CaptureError, match="dark"):
        check_image(prediction, np.zeros((15, 3)), FINE)


def test_another_shape_is_refused(prediction: PadPrediction) -> None:
    with pytest.raises(CaptureError, match="shape"):
        check_image(prediction, np.ones((14, 3)), FINE)


def test_one_image_does_not_turn_a_lamp_that_cannot(prediction: PadPrediction) -> None:
    straight = prediction.unit(prediction.phi[:, None])
    fixed = replace(prediction, table=np.repeat(straight, prediction.table.shape[1], axis=1))
    found = check_image(fixed, fixed.together - 0.2 * fixed.alone[4], FINE)
    assert FiberState.MOVED not in {one.state for one in found.fibers}
