"""CMA-ES over stepped values finds what looking at every combination finds, with fewer looks."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from optimize.dimensions import stepped_search
from optimize.dimensions.stepped_search import Point


def valley(sizes: tuple[int, ...], seed: int) -> dict[Point, float]:
    """Return losses of all points: a bent valley with a ripple, the lowest somewhere in it."""
    rng = np.random.default_rng(seed)
    low = rng.uniform(0.0, 1.0, len(sizes))
    mixed = rng.uniform(-0.6, 0.6)
    losses = {}
    for point in itertools.product(*(range(size) for size in sizes)):
        x = np.array(point) / (np.array(sizes) - 1.0) - low
        ripple = 0.002 * np.cos(17.0 * x).sum()
        losses[point] = float(x @ x + mixed * x[0] * x[-1] + ripple)
    return losses


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("sizes", [(9, 9), (7, 8, 6)])
def test_it_finds_the_best_of_all_combinations(sizes: tuple[int, ...], seed: int) -> None:
    losses = valley(sizes, seed)
    start = tuple(size // 2 for size in sizes)
    known = stepped_search(losses.__getitem__, sizes, start, most=20 * len(sizes) + 5, seed=seed)
    ranked = sorted(losses.values())
    # Within the best two of 81 or of 336: a valley has neighbors that differ by little.
    assert min(known.values()) <= ranked[1]


def test_it_asks_no_point_twice_and_none_that_is_no_sensor() -> None:
    losses, asked = valley((9, 9), 1), []

    def loss(point: Point) -> float:
        asked.append(point)
        return losses[point]

    known = stepped_search(
        loss, (9, 9), (8, 0), most=30, allowed=lambda point: point[0] > point[1], seed=4
    )
    assert sorted(asked) == sorted(known)
    assert len(set(asked)) == len(asked) <= 30
    assert all(a > b for a, b in asked)


def test_the_same_seed_looks_at_the_same_points() -> None:
    losses = valley((9, 9), 2)
    first, again = (
        stepped_search(losses.__getitem__, (9, 9), (4, 4), most=40, seed=3) for _ in range(2)
    )
    assert list(first.items()) == list(again.items())


def test_a_dimension_of_one_value_does_not_move() -> None:
    losses = valley((9, 9), 5)
    known = stepped_search(lambda p: losses[p[0], p[2]], (9, 1, 9), (4, 0, 4), most=60, seed=0)
    assert {point[1] for point in known} == {0}
    assert min(known.values()) <= sorted(losses.values())[1]
