"""Classes that builders can wire are scored as a whole: the same best as brute force finds."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from optimize.design import SearchLimits, unlimited
from optimize.design.runs import Runs, count_runs
from optimize.scoring import TableScorer
from optimize.search import alternating_search
from optimize.search.colors import all_colorings, canonical, exact_colors
from optimize.search.colors.combinations import are_combinations, count_combinations
from render.errors import TactiluxError
from render.scene import RGB, Palette
from render.transport import TransportTable

MakeTable = Callable[..., TransportTable]


def limits_with(
    fibers: int,
    *,
    off: bool,
    lit: int | None = None,
    runs: int | None = None,
    leds: tuple[int, ...] = (99, 99, 99),
    near: tuple[tuple[int, int], ...] = (),
) -> SearchLimits:
    """Return limits whose ring is no simple row of numbers."""
    ring = np.random.default_rng(fibers).permutation(fibers)
    free = unlimited(fibers, off=off)
    counts = np.array([*leds, fibers][: 3 + off])
    given = None if runs is None else Runs(runs, ring)
    exclusive = np.zeros((fibers, fibers), dtype=bool) if near else None
    for one, other in near:
        assert exclusive is not None
        exclusive[one, other] = exclusive[other, one] = True
    return replace(free, most_lit=lit, runs=given, led_counts=counts, exclusive=exclusive)


def every(limits: SearchLimits) -> np.ndarray:
    """Return all colorings within limits, by brute force."""
    fibers = len(limits.allowed)
    all_of_them = itertools.product(range(-limits.may_be_off, 3), repeat=fibers)
    colors = np.array(list(all_of_them))
    return colors[limits.fits(colors) & (colors >= 0).any(axis=1)]


CLASSES = [
    {"off": True, "lit": 3},
    {"off": True, "lit": 3, "leds": (1, 1, 1)},
    {"off": True, "lit": 4, "leds": (0, 2, 1)},
    {"off": True, "lit": 4, "runs": 2},
    {"off": True, "lit": 4, "near": ((0, 1), (1, 2), (3, 4))},
    {"off": True, "lit": 3, "runs": 2, "near": ((3, 5), (0, 4))},
    {"off": True, "lit": 4, "runs": 1},
    {"off": True, "runs": 3, "leds": (2, 2, 2)},
    {"off": False, "runs": 1},
    {"off": False, "runs": 2},
    {"off": False, "runs": 4},
    {"off": False, "runs": 3, "leds": (3, 4, 3)},
]


@pytest.mark.parametrize("given", CLASSES, ids=str)
@pytest.mark.parametrize("fixed", [False, True])
def test_the_best_of_a_class_is_that_of_brute_force(
    make_table: MakeTable, given: dict[str, object], fixed: bool
) -> None:
    limits = limits_with(7, **given)
    if fixed:
        limits.allowed[2] = np.arange(limits.allowed.shape[1]) == 1
        limits.allowed[5, 0] = False
    scorer = TableScorer(make_table(7, 3, 2, 3, 5, lam=60.0, seed=5), limits=limits)
    phi, colors = np.linspace(0.5, 2.5, 7), every(limits)
    assert are_combinations(limits)
    found = exact_colors(scorer, phi)
    scores = scorer.scores(colors, phi)
    assert found.score == pytest.approx(scores.max(), rel=1e-12)
    assert limits.fits(found.colors[None])[0]
    alike = np.unique(canonical(colors), axis=0) if scorer.colors_alike else colors
    assert found.evaluated == len(alike)


@pytest.mark.parametrize("given", [one for one in CLASSES if "near" not in one], ids=str)
@pytest.mark.parametrize("alike", [False, True])
def test_a_class_has_as_many_colorings_as_are_counted(
    given: dict[str, object], alike: bool
) -> None:
    limits = limits_with(6, **given)
    colors = every(limits)
    total = len(np.unique(canonical(colors), axis=0)) if alike else len(colors)
    counted = count_combinations(limits, alike=alike)
    assert counted >= total
    if "leds" not in given:
        assert counted == total
    listed = all_colorings(limits, 10_000, alike=False)
    assert listed is not None
    assert {*map(tuple, listed)} == {*map(tuple, colors)}


def test_runs_are_counted_around_the_ring_past_lamps_that_are_off() -> None:
    rng = np.random.default_rng(0)
    for colors in rng.integers(-1, 3, (200, 6)):
        lit = [color for color in colors if color >= 0]
        joined = "".join(map(str, lit))
        changes = sum(first != last for first, last in itertools.pairwise([*joined, *joined[:1]]))
        expected = max(changes, 1) if lit else 0
        assert count_runs(colors[None])[0] == expected
        assert count_runs(np.roll(colors, 2)[None])[0] == expected


@pytest.mark.parametrize("given", [one for one in CLASSES if "runs" in one], ids=str)
def test_the_nearest_coloring_with_few_runs_is_the_best_of_brute_force(
    given: dict[str, object],
) -> None:
    limits = limits_with(6, **given)
    colors = every(limits)
    dark = [np.full((1, 6), -1)] if limits.may_be_off else []
    colors = np.concatenate([colors, *dark])
    rng = np.random.default_rng(1)
    for _ in range(5):
        wanted = rng.uniform(size=limits.allowed.shape)
        choices = np.where(colors < 0, 3, colors)
        values = wanted[np.arange(6), choices].sum(axis=1)
        near = limits.nearest_colors(wanted)
        assert limits.fits(near[None])[0]
        value = wanted[np.arange(6), np.where(near < 0, 3, near)].sum()
        assert value == pytest.approx(values.max())


def test_a_class_that_no_machine_could_score_is_refused(make_table: MakeTable) -> None:
    limits = limits_with(40, off=True, lit=12)
    scorer = TableScorer(make_table(40, 1, 1, 2, 4), limits=limits)
    with pytest.raises(TactiluxError, match="at most 12 of 40 lamps lit would score"):
        exact_colors(scorer, scorer.at_node(0))


FIVE = Palette(
    ("red", "green", "blue", "amber", "white"),
    ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.8, 0.3, 0.0), (0.4, 0.5, 0.3)),
    RGB.channels,
    ("#000000",) * 5,
)


def test_two_runs_of_64_lamps_in_five_lights_are_all_of_them(make_table: MakeTable) -> None:
    limits = replace(unlimited(64, FIVE), runs=Runs(2, np.arange(64)))
    scorer = TableScorer(make_table(64, 1, 1, 2, 4, lam=60.0, seed=2), limits=limits)
    phi = scorer.at_node(0)
    number = np.arange(64)
    pairs = [(a, b) for a in range(5) for b in range(5) if a != b]
    colors = [np.full(64, color) for color in range(5)]
    for low, high in itertools.combinations(range(64), 2):
        inside = (low <= number) & (number < high)
        colors += [np.where(inside, a, b) for a, b in pairs]
    found = exact_colors(scorer, phi)
    assert (
        found.evaluated == len(colors) == count_combinations(limits, alike=False) == 5 + 20 * 2016
    )
    assert found.score == pytest.approx(scorer.scores(np.array(colors), phi).max(), rel=1e-12)


@pytest.mark.parametrize("given", CLASSES[:4], ids=str)
def test_the_whole_search_proves_a_class_where_lamps_do_not_turn(
    make_table: MakeTable, given: dict[str, object]
) -> None:
    straight = np.full((7, 1), np.pi / 2)
    limits = replace(limits_with(7, **given), low=straight, high=straight)
    scorer = TableScorer(make_table(7, 1, 2, 3, 5, lam=60.0, seed=5), limits=limits)
    colors, phi = every(limits), straight[:, 0]
    start = scorer.design(phi, colors[0])
    found = alternating_search(scorer, start)
    scores = scorer.scores(colors, phi)
    assert found.score == pytest.approx(scores.max(), rel=1e-12)
    alike = np.unique(canonical(colors), axis=0) if scorer.colors_alike else colors
    assert found.proven == len(alike)
    assert scorer.score(phi, found.colored.power) == pytest.approx(found.score)
    free = TableScorer(scorer.table, limits=replace(limits, continuous_power=True))
    assert alternating_search(free, start).proven is None
