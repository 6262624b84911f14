"""All colorings are all of them, each once, or it is said that there are too many."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from optimize.design import unlimited
from optimize.search.colors import all_colorings, canonical
from render.scene.colors import palette_of


@pytest.mark.parametrize("off", [True, False])
@pytest.mark.parametrize("leds", [(1, 1, 1), (2, 0, 5), (5, 5, 5)])
@pytest.mark.parametrize("most", [None, 2, 4])
def test_they_are_those_of_the_product(off: bool, leds: tuple[int, ...], most: int | None) -> None:
    limits = unlimited(5, off=off)
    counts = np.array([*leds, 5][: 3 + off])
    limits = replace(limits, led_counts=counts, most_lit=most)
    every = np.array(list(itertools.product(range(-off, 3), repeat=5)))
    every = every[limits.fits(every) & (every >= 0).any(axis=1)]
    found = all_colorings(limits, 2000, alike=False)
    assert found is not None
    assert len(np.unique(found, axis=0)) == len(found)
    assert {*map(tuple, found)} == {*map(tuple, every)}
    alike = all_colorings(limits, 2000, alike=True)
    assert alike is not None
    if len(set(leds)) == 1:
        renamed = np.unique(canonical(every), axis=0) if len(every) else every
        assert {*map(tuple, alike)} == {*map(tuple, renamed)}


def test_a_fixed_lamp_keeps_its_color() -> None:
    limits = replace(unlimited(4, off=True), most_lit=2)
    limits.allowed[2] = [False, True, False, False]
    found = all_colorings(limits, 1000, alike=False)
    assert found is not None
    assert (found[:, 2] == 1).all()
    assert len(found) == 1 + 3 * 3


def test_too_many_are_none() -> None:
    limits = replace(unlimited(40, off=True), most_lit=3, led_counts=np.array([1, 1, 1, 40]))
    total = sum(math.comb(40, lit) for lit in (1, 2, 3))
    assert all_colorings(limits, total - 1, alike=True) is None
    found = all_colorings(limits, total, alike=True)
    assert found is not None
    assert len(found) == total
    assert all_colorings(unlimited(60), 20_000, alike=True) is None


@pytest.mark.parametrize("leds", [(1, 1, 1), (2, 0, 5)])
@pytest.mark.parametrize("most", [None, 2])
def test_leds_are_counted_whatever_shots_they_shine_in(
    leds: tuple[int, ...], most: int | None
) -> None:
    palette = palette_of(None, None, 2)
    limits = unlimited(3, palette, off=True)
    limits = replace(limits, led_counts=np.array([*leds, 3]), most_lit=most)
    every = np.array(list(itertools.product(range(-1, len(palette.names)), repeat=3)))
    kept = []
    for row in every:
        used = [palette.names[color].split("@")[0] for color in row if color >= 0]
        fits = all(
            used.count(led) <= count
            for led, count in zip(("red", "green", "blue"), leds, strict=True)
        )
        kept.append(fits and len(used) <= (3 if most is None else most))
    assert np.array_equal(limits.fits(every), kept)
    found = all_colorings(limits, 2000, alike=False)
    assert found is not None
    lit = (every >= 0).any(axis=1)
    assert {*map(tuple, found)} == {*map(tuple, every[kept & lit])}
    # The nearest coloring is the one that brute force prefers.
    preference = np.random.default_rng(2).uniform(size=limits.allowed.shape)
    worth = preference[np.arange(3), every].sum(axis=1)
    best = every[kept][worth[kept].argmax()]
    assert np.array_equal(limits.nearest_colors(preference), best)
