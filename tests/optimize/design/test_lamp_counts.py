"""Counts of colors and parts are kept to: what brute force lists by rules of its own."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from optimize.design import limits_of
from optimize.placement import searched_scene
from optimize.search.colors import all_colorings, are_combinations
from render.errors import DesignError, SceneError
from render.scene import Scene, load_scene

DIGIT = load_scene("digit")


def counting(*counts: dict[str, object], **search: object) -> Scene:
    return DIGIT.with_(schema=2, search={"counts": list(counts), **search})


@pytest.mark.parametrize(
    ("counts", "keeps"),
    [
        ([{"of": ["red"], "max": 1}], lambda n: n[0] <= 1),
        ([{"of": ["red"], "exactly": 2}], lambda n: n[0] == 2),
        ([{"of": ["red", "blue"], "max": 1}], lambda n: n[0] + n[2] <= 1),
        ([{"of": ["red", "blue"], "exactly": 2}, {"of": ["blue"], "max": 1}],
         lambda n: n[0] + n[2] == 2 and n[2] <= 1),
        ([{"of": ["green"], "exactly": 0}], lambda n: n[1] == 0),
    ],
)  # fmt: skip
def test_allowed_are_the_colorings_of_brute_force(counts: list, keeps) -> None:
    limits = limits_of(counting(*counts, lamps=2))
    product = np.array(list(itertools.product(range(-1, 3), repeat=3)))
    numbers = [[int((row == color).sum()) for color in range(3)] for row in product]
    expected = np.array([sum(n) <= 2 and keeps(n) for n in numbers])
    assert limits.fits(product).tolist() == expected.tolist()
    every = all_colorings(limits, 100, alike=False)
    assert every is not None
    lit = product[expected & (product >= 0).any(axis=1)]
    assert {*map(tuple, every.tolist())} == {*map(tuple, lit.tolist())}
    rng = np.random.default_rng(3)
    for _ in range(10):
        worth = rng.normal(size=limits.allowed.shape)
        sums = [worth[np.arange(3), row].sum() for row in product[expected]]
        found = limits.nearest_colors(worth)
        assert worth[np.arange(3), found].sum() == pytest.approx(max(sums))


def test_counts_of_one_color_at_most_leave_a_class_that_is_compared_as_a_whole() -> None:
    placed = searched_scene(counting({"of": ["red"], "max": 1}, lamps=3))
    limits = limits_of(placed)
    assert are_combinations(limits)
    assert limits.led_counts.tolist() == [1, 34, 34, 34]
    exact = searched_scene(counting({"of": ["red"], "exactly": 1}, lamps=3))
    assert not are_combinations(limits_of(exact))


def test_a_part_of_several_dies_is_each_of_them() -> None:
    scene = counting(
        {"of": ["ws2812b"], "exactly": 2},
        {"of": ["ws2812b-blue", "red-0603"], "max": 1},
        lamps=5,
        parts=["red-0603", "ws2812b", "amber-0603"],
    )
    assert limits_of(scene).allowed.any()  # its own lamps are none of these parts yet
    placed = searched_scene(scene)
    limits, names = limits_of(placed), placed.palette.names
    rng = np.random.default_rng(4)
    for _ in range(20):
        colors = limits.nearest_colors(rng.uniform(size=limits.allowed.shape))
        lit = [names[color] for color in colors if color >= 0]
        assert len(lit) == 5
        assert sum(name.startswith("ws2812b-") for name in lit) == 2
        assert lit.count("ws2812b-blue") + lit.count("red-0603") <= 1


@pytest.mark.parametrize(
    ("count", "said"),
    [
        ({"of": ["reds"], "max": 1},
         "search.counts.0.of = reds, allowed: red, green, blue, did you mean red?"),
        ({"of": ["red"]}, "search.counts.0 names neither max nor exactly, allowed: one of the two"),
        ({"of": ["red"], "max": 2, "exactly": 1}, "search.counts.0 names max and exactly, allowed"),
        ({"of": ["red", "red"], "max": 2}, "search.counts.0.of names red twice, allowed: once"),
        ({"of": ["red"], "exactly": 3},
         "search.lamps = 2, but search.counts asks for 3, allowed: at least 3"),
        ({"of": [], "max": 2}, "search.counts.0.of = []"),
        ({"of": ["red"], "max": -1}, "search.counts.0.max = -1"),
    ],
)  # fmt: skip
def test_counts_that_cannot_be_are_refused(count: dict[str, object], said: str) -> None:
    with pytest.raises(SceneError) as refused:
        counting(count, lamps=2)
    assert said in str(refused.value)


def test_more_than_there_are_lamps_are_refused_with_how_many_may_be_one() -> None:
    with pytest.raises(DesignError, match=r"exactly 4 of red, but 3 lamps .* allowed: at most 3"):
        limits_of(counting({"of": ["red"], "exactly": 4}))


def test_counts_that_contradict_each_other_are_refused() -> None:
    with pytest.raises(DesignError, match=r"no choice of colors .* search.counts"):
        limits_of(counting({"of": ["red"], "exactly": 2}, {"of": ["red", "blue"], "max": 1}))
