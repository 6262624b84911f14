"""Reservoirs draw as often as weights say, and what they draw stands for all."""

from __future__ import annotations

from types import ModuleType

import drjit as dr
import numpy as np

from render.sampling.reservoirs import OneNumberReservoir, Reservoir

DRAWS = 1 << 16


def assert_drawn_by(weights: np.ndarray, index: np.ndarray) -> None:
    fraction = np.bincount(index, minlength=len(weights)) / DRAWS
    expected = weights / weights.sum()
    error = np.sqrt(expected * (1 - expected) / DRAWS)
    assert (np.abs(fraction - expected) <= 4 * error).all()


def test_an_item_is_drawn_as_often_as_its_weight_says_and_stands_for_all(mono: ModuleType) -> None:
    rng = np.random.default_rng(4)
    weights = np.array([0.0, 3.0, 1.0, 0.0, 4.0])
    drawn = Reservoir.holding(mono.UInt32(0))
    for index, weight in enumerate(weights):
        number = mono.Float(rng.random(DRAWS).astype(np.float32))
        drawn = drawn.update(mono.UInt32(index), dr.full(mono.Float, weight, DRAWS), number)
    index = np.array(drawn.item)
    assert_drawn_by(weights, index)
    np.testing.assert_allclose(np.array(drawn.total), weights.sum())
    np.testing.assert_allclose(np.array(drawn.weight), weights[index])
    np.testing.assert_allclose(np.array(drawn.probability()), weights[index] / weights.sum())
    # Each of them stands for two by itself, and one of four reservoirs for a fourth.
    for contribution, part in (
        (drawn.contribution_weight(2.0), 2.0), (drawn.contribution_weight(draws=4), 0.25)
    ):  # fmt: skip
        np.testing.assert_allclose(
            np.array(contribution * drawn.weight), part * weights.sum(), rtol=1e-5
        )


def test_one_number_draws_among_many_items_as_often_as_they_say(mono: ModuleType) -> None:
    rng = np.random.default_rng(6)
    weights, represented = rng.random(16) ** 4, rng.random(16) + 0.5
    weights[[0, 7]] = 0.0
    numbers = mono.Float(rng.random(DRAWS).astype(np.float32))
    drawn = OneNumberReservoir.drawing(mono.UInt32(0), numbers)
    for index, (weight, count) in enumerate(zip(weights, represented, strict=True)):
        drawn = drawn.offered(
            mono.UInt32(index), dr.full(mono.Float, weight, DRAWS), mono.Float(weight * count)
        )
    index = np.array(drawn.item)
    assert_drawn_by(weights * represented, index)
    number = np.array(drawn.number)
    assert ((number >= 0) & (number <= 1)).all()
    assert np.abs(number.mean() - 0.5) < 4 / np.sqrt(12 * DRAWS)
    # Those drawn, times what they stand for, make up the whole.
    np.testing.assert_allclose(
        np.array(drawn.contribution_weight()) * weights[index],
        (weights * represented).sum(),
        rtol=1e-5,
    )


def test_without_weight_nothing_is_drawn(mono: ModuleType) -> None:
    drawn = OneNumberReservoir.drawing(mono.UInt32(0), mono.Float(0.3))
    drawn = drawn.offered(mono.UInt32(5), mono.Float(0.0))
    assert drawn.contribution_weight()[0] == 0
    assert drawn.probability()[0] == 0
    assert np.isfinite(np.array(drawn.number)).all()
