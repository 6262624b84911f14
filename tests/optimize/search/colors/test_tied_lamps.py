"""Lamps that are tied have one color in every search: what brute force finds among such designs."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from optimize.design import Colors, Design, SearchLimits, unlimited
from optimize.scoring import TableScorer
from optimize.search.colors import all_colorings, exact_colors, grouped_colors, quick_colors
from optimize.search.local_refinement import NominalScore, multi_start
from render.errors import DesignError
from render.transport import TransportTable

MakeTable = Callable[..., TransportTable]
TIES = np.array([0, 1, 2, 1, 0, 3])
"""Two pairs, and two lamps that are alone."""


def tied(*, off: bool, most: int | None, leds: tuple[int, ...]) -> SearchLimits:
    counts = np.array([*leds, 6][: 3 + off])
    return replace(unlimited(6, off=off), ties=TIES, most_lit=most, led_counts=counts)


def brute_force(limits: SearchLimits) -> Colors:
    """Return all allowed colorings that light something, by rules of its own."""
    found = []
    for colors in itertools.product(range(-1 if limits.may_be_off else 0, 3), repeat=6):
        lit = sum(color >= 0 for color in colors)
        few = limits.most_lit is None or lit <= limits.most_lit
        counted = all(colors.count(c) <= limits.led_counts[c] for c in range(3))
        pairs = colors[0] == colors[4] and colors[1] == colors[3]
        if lit and few and counted and pairs:
            found.append(colors)
    return np.array(found).reshape(-1, 6)


CASES = [
    (True, None, (6, 6, 6)), (True, 3, (6, 6, 6)), (True, 4, (2, 1, 3)), (False, None, (2, 2, 3)),
    (True, 1, (1, 1, 1)), (False, None, (3, 4, 5)),
]  # fmt: skip


@pytest.mark.parametrize(("off", "most", "leds"), CASES)
def test_allowed_and_listed_are_the_same_as_by_brute_force(
    off: bool, most: int | None, leds: tuple[int, ...]
) -> None:
    limits = tied(off=off, most=most, leds=leds)
    expected = {*map(tuple, brute_force(limits).tolist())}
    product = np.array(list(itertools.product(range(-off, 3), repeat=6)))
    fitting = product[limits.fits(product) & (product >= 0).any(axis=1)]
    assert {*map(tuple, fitting.tolist())} == expected
    every = all_colorings(limits, 5000, alike=False)
    assert every is not None
    assert {*map(tuple, every.tolist())} == expected
    assert len(every) == len(expected)


@pytest.mark.parametrize(("off", "most", "leds"), CASES)
def test_the_preferred_colors_are_the_best_of_all(
    off: bool, most: int | None, leds: tuple[int, ...]
) -> None:
    limits, rng = tied(off=off, most=most, leds=leds), np.random.default_rng(5)
    every = brute_force(limits)
    if off:
        every = np.concatenate([every, np.full((1, 6), -1)])
    for _ in range(20):
        wanted = rng.uniform(size=limits.allowed.shape)
        worth = [wanted[np.arange(6), colors].sum() for colors in every]
        found = limits.nearest_colors(wanted)
        assert limits.fits(found[None])[0]
        assert wanted[np.arange(6), found].sum() == pytest.approx(max(worth), rel=1e-9)


def test_pairs_without_two_leds_of_a_color_are_refused() -> None:
    assert tied(off=False, most=None, leds=(1, 1, 6)).nearest_colors(np.zeros((6, 3))).size == 6
    limits = tied(off=False, most=None, leds=(1, 1, 1))
    with pytest.raises(DesignError, match="no choice of colors fulfills the constraints"):
        limits.nearest_colors(np.zeros((6, 3)))


@pytest.mark.parametrize(("off", "most", "leds"), CASES)
def test_searches_end_at_the_best_of_all(
    make_table: MakeTable, off: bool, most: int | None, leds: tuple[int, ...]
) -> None:
    limits = tied(off=off, most=most, leds=leds)
    scorer = TableScorer(make_table(6, 3, 1, 3, 5, lam=60.0, seed=3), limits=limits)
    phi, every = np.linspace(0.6, 2.4, 6), brute_force(limits)
    scores = scorer.scores(every, phi)
    exact, quick = exact_colors(scorer, phi), quick_colors(scorer, phi)
    assert exact.score == pytest.approx(scores.max(), rel=1e-9)
    assert quick.score == pytest.approx(scores.max(), rel=1e-9)
    for found in (exact, quick):
        assert limits.fits(found.colors[None])[0]
        assert all(limits.fits(np.array(other)[None])[0] for other in found.ties)


def test_moves_climb_pairs_together_to_the_best_of_all(make_table: MakeTable) -> None:
    limits = tied(off=True, most=4, leds=(2, 3, 3))
    still = replace(limits, low=np.full((6, 1), 1.2), high=np.full((6, 1), 1.2))
    scorer = TableScorer(make_table(6, 3, 1, 3, 5, lam=60.0, seed=8), limits=still)
    goal, phi = NominalScore(scorer), np.full(6, 1.2)
    every = brute_force(limits)
    best = max(goal.value(scorer.design(phi, colors)) for colors in every)
    starts = [scorer.design(phi, colors) for colors in every[:: len(every) // 5]]
    found = multi_start(scorer, goal, starts)
    assert isinstance(found.design, Design)
    assert found.score == pytest.approx(best, rel=1e-9)
    assert limits.fits(found.design.colors[None])[0]


def test_neighbors_of_one_color_keep_to_pairs(make_table: MakeTable) -> None:
    ties = np.array([0, 1, 2, 2, 1, 0])
    limits = replace(unlimited(6), ties=ties)
    scorer = TableScorer(make_table(6, 3, 1, 3, 5, lam=60.0, seed=3), limits=limits)
    assert limits.fits(grouped_colors(scorer, np.full(6, 1.4)).colors[None])[0]
