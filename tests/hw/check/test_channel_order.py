"""Channels that all fibers share in a wrong order are the photographs' fault, not the fibers'."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from hw.camera.self_test import check_order
from hw.check.prediction import PadPrediction
from hw.errors import CaptureError
from render.arrays import Array

GAINS = np.array([1.3, 0.7, 1.0])
ORDERS = [order for order in itertools.permutations(range(3)) if order != (0, 1, 2)]


def noisy(colors: Array) -> Array:
    return colors * GAINS + 0.3 * np.random.default_rng(0).standard_normal(colors.shape)


def test_colors_in_their_own_channels_pass(prediction: PadPrediction) -> None:
    check_order(prediction.alone.sum(axis=1), noisy(prediction.alone.sum(axis=1)))
    check_order(prediction.together, noisy(prediction.together))


@pytest.mark.parametrize("order", ORDERS)
def test_another_order_is_refused(prediction: PadPrediction, order: tuple[int, ...]) -> None:
    for expected in (prediction.alone.sum(axis=1), prediction.together):
        with pytest.raises(CaptureError, match="wrong channels"):
            check_order(expected, noisy(expected)[:, list(order)])


def test_it_says_where_each_color_is(prediction: PadPrediction) -> None:
    with pytest.raises(CaptureError, match="red in B, green in G, blue in R"):
        check_order(prediction.together, noisy(prediction.together)[:, ::-1])


@pytest.mark.parametrize("fiber", [0, 9, 15])
def test_one_swapped_fiber_is_left_to_the_check(prediction: PadPrediction, fiber: int) -> None:
    colors = prediction.alone.copy()
    colors[fiber] = np.roll(colors[fiber], 1, axis=-1)
    check_order(prediction.alone.sum(axis=1), noisy(colors.sum(axis=1)))
    check_order(prediction.together, noisy(colors.sum(axis=0)))


def test_white_light_has_no_order(prediction: PadPrediction) -> None:
    white = np.repeat(prediction.alone.sum(axis=(1, 2))[:, None], 3, axis=1)
    check_order(white, noisy(white))


def test_darkness_is_left_to_the_check(prediction: PadPrediction) -> None:
    check_order(prediction.together, np.zeros((15, 3)))
