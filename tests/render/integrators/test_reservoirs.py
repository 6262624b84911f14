"""Reservoirs of light vertices: drawn by hope, standing for all that were offered."""

from __future__ import annotations

from types import ModuleType

import drjit as dr
import numpy as np

from render.integrators.reservoirs import Drawn, Glimpsed

COUNT = 1 << 16


def assert_drawn_by(hopes: np.ndarray, place: np.ndarray) -> None:
    share = np.bincount(place, minlength=len(hopes)) / COUNT
    expected = hopes / hopes.sum()
    error = np.sqrt(expected * (1 - expected) / COUNT)
    assert (np.abs(share - expected) <= 4 * error).all()


def test_a_vertex_is_drawn_as_often_as_its_promise_says_and_stands_for_all(
    mono: ModuleType,
) -> None:
    rng = np.random.default_rng(4)
    hopes = np.array([0.0, 3.0, 1.0, 0.0, 4.0])
    drawn = Drawn.none()
    for place, hope in enumerate(hopes):
        number = mono.Float(rng.random(COUNT).astype(np.float32))
        drawn = drawn.offered(
            mono.UInt32(place), mono.Float(2.0), dr.full(mono.Float, hope, COUNT), number
        )
    assert_drawn_by(hopes, np.array(drawn.place))
    np.testing.assert_allclose(np.array(drawn.total), hopes.sum())
    np.testing.assert_allclose(np.array(drawn.hope), hopes[np.array(drawn.place)])
    # Each of them stands for two by itself.
    np.testing.assert_allclose(np.array(drawn.all() * drawn.hope), 2 * hopes.sum(), rtol=1e-5)


def test_one_number_draws_among_many_glimpses_as_often_as_they_say(mono: ModuleType) -> None:
    rng = np.random.default_rng(6)
    hopes, stand_for = rng.random(16) ** 4, rng.random(16) + 0.5
    hopes[[0, 7]] = 0.0
    drawn = Glimpsed.none(mono.Float(rng.random(COUNT).astype(np.float32)))
    for place, (hope, count) in enumerate(zip(hopes, stand_for, strict=True)):
        drawn = drawn.offered(
            mono.UInt32(place), dr.full(mono.Float, hope, COUNT), mono.Float(count)
        )
    place = np.array(drawn.place)
    assert_drawn_by(hopes * stand_for, place)
    number = np.array(drawn.number)
    assert ((number >= 0) & (number <= 1)).all()
    assert np.abs(number.mean() - 0.5) < 4 / np.sqrt(12 * COUNT)
    # Those drawn, times what they stand for, make up the whole.
    np.testing.assert_allclose(
        np.array(drawn.all()) * hopes[place], (hopes * stand_for).sum(), rtol=1e-5
    )


def test_where_nothing_is_offered_nothing_is_drawn(mono: ModuleType) -> None:
    drawn = Glimpsed.none(mono.Float(0.3)).offered(mono.UInt32(5), mono.Float(0.0))
    assert drawn.all()[0] == 0
    assert np.isfinite(np.array(drawn.number)).all()
