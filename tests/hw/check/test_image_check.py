"""One image of all fibers shows what is large: dead, dim and wrongly colored fibers."""

from __future__ import annotations

import numpy as np
import pytest

from hw.check.image_check import check_image
from hw.check.prediction import Prediction
from hw.check.tolerances import STARTS, tolerances
from hw.check.verdict import State
from hw.errors import CaptureError

FINE = tolerances(sweep=False, starts=STARTS, noise=np.array(0.045))


def test_a_healthy_image_is_healthy_at_any_exposure(prediction: Prediction) -> None:
    for gain in (0.3, 1.0, 4.0):
        assert check_image(prediction, gain * prediction.together, FINE).ok


@pytest.mark.parametrize("fiber", [1, 5, 9, 16])
def test_a_dead_fiber_is_named(prediction: Prediction, fiber: int) -> None:
    colors = prediction.together - prediction.alone[fiber]
    verdict = check_image(prediction, colors, FINE)
    assert [(one.index, one.state) for one in verdict.faults] == [(fiber, State.DEAD)]


@pytest.mark.parametrize("fiber", [3, 9])
def test_a_swapped_color_is_named(prediction: Prediction, fiber: int) -> None:
    own = prediction.alone[fiber]
    colors = prediction.together - own + np.roll(own, 1, axis=-1)
    verdict = check_image(prediction, colors, FINE)
    assert [(one.index, one.state) for one in verdict.faults] == [(fiber, State.SWAPPED)]


def test_what_no_single_fault_explains_is_unclear(prediction: Prediction) -> None:
    colors = prediction.together * np.where(np.arange(15) % 2, 1.0, 0.6)[:, None]
    verdict = check_image(prediction, colors, FINE)
    assert not verdict.ok
    assert {one.state for one in verdict.faults} == {State.UNCLEAR}


def test_darkness_is_one_sentence(prediction: Prediction) -> None:
    with pytest.raises(CaptureError, match="dark"):
        check_image(prediction, np.zeros((15, 3)), FINE)


def test_another_shape_is_refused(prediction: Prediction) -> None:
    with pytest.raises(CaptureError, match="shape"):
        check_image(prediction, np.ones((14, 3)), FINE)
