"""Searches keep to exclusions and budgets, and find the best that they leave: by brute force."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from optimize.design import Budget, SearchLimits, unlimited
from optimize.scoring import TableScorer
from optimize.search.colors import all_colorings, exact_colors, grouped_colors, quick_colors
from optimize.search.local_refinement import NominalScore, multi_start
from render.errors import DesignError
from render.transport import TransportTable

MakeTable = Callable[..., TransportTable]
FIBERS = 6
EVERY = np.array(list(itertools.product(range(-1, 3), repeat=FIBERS)))
PAIRS = ((0, 1), (1, 2), (0, 2), (4, 5))
COST = np.random.default_rng(7).uniform(0.05, 3.0, (FIBERS, 4)) * [1, 1, 1, 0]


def limits(
    pairs: tuple[tuple[int, int], ...] = PAIRS, budget: float | None = 4.0, **given: object
) -> SearchLimits:
    exclusive = np.zeros((FIBERS, FIBERS), dtype=bool)
    for first, second in pairs:
        exclusive[first, second] = exclusive[second, first] = True
    budgets = () if budget is None else (Budget("search.current", COST, budget),)
    free = unlimited(FIBERS, off=True)
    return replace(free, exclusive=exclusive, budgets=budgets, **given)


def fits_by_hand(limits: SearchLimits) -> np.ndarray:
    lit = EVERY >= 0
    fits = np.ones(len(EVERY), dtype=bool)
    for first, second in np.argwhere(np.triu(limits.exclusive)):
        fits &= ~(lit[:, first] & lit[:, second])
    for budget in limits.budgets:
        fits &= budget.cost[np.arange(FIBERS), EVERY].sum(axis=1) <= budget.limit
    return fits


CASES = [
    limits(),
    limits(budget=None),
    limits(pairs=()),
    limits(budget=1.0),
    limits(most_lit=2),
    limits(pairs=tuple(itertools.combinations(range(FIBERS), 2))),
]


@pytest.mark.parametrize("case", CASES)
def test_what_fits_is_what_every_pair_and_every_sum_allows(case: SearchLimits) -> None:
    most = FIBERS if case.most_lit is None else case.most_lit
    by_hand = fits_by_hand(case) & ((EVERY >= 0).sum(axis=1) <= most)
    assert by_hand.any()
    assert not by_hand.all()
    assert np.array_equal(case.fits(EVERY), by_hand)
    every = all_colorings(case, len(EVERY), alike=False)
    assert every is not None
    lit = EVERY[by_hand & (EVERY >= 0).any(axis=1)]
    assert sorted(every.tolist()) == sorted(lit.tolist())


@pytest.mark.parametrize("case", CASES)
def test_exact_and_quick_searches_find_the_best_that_fits(
    make_table: MakeTable, case: SearchLimits
) -> None:
    scorer = TableScorer(make_table(FIBERS, 5, 2, 3, 5), limits=case)
    phi = np.linspace(0.6, 2.4, FIBERS)
    allowed = EVERY[case.fits(EVERY)]
    best = scorer.scores(allowed, phi).max()
    for search in (exact_colors, quick_colors):
        found = search(scorer, phi)
        assert case.fits(found.colors[None])[0]
        assert found.score == pytest.approx(best, rel=1e-9)


def test_groups_keep_to_exclusions_and_budgets(make_table: MakeTable) -> None:
    case = limits(pairs=((0, 2), (1, 5)), budget=9.0)
    scorer = TableScorer(make_table(FIBERS, 5, 2, 3, 5), limits=case)
    found = grouped_colors(scorer, np.linspace(0.6, 2.4, FIBERS))
    assert case.fits(found.colors[None])[0]


@pytest.mark.parametrize("case", CASES)
def test_the_nearest_coloring_is_that_of_brute_force(case: SearchLimits) -> None:
    preference = np.random.default_rng(3).normal(size=(FIBERS, 4))
    allowed = EVERY[case.fits(EVERY)]
    worth = preference[np.arange(FIBERS), allowed].sum(axis=1)
    found = case.nearest_colors(preference)
    assert case.fits(found[None])[0]
    assert preference[np.arange(FIBERS), found].sum() == pytest.approx(worth.max())


def test_climbing_moves_light_to_another_lamp_in_a_color_that_it_may_have(
    make_table: MakeTable,
) -> None:
    # Lamps of a place may each have colors of their own: the light of one moves to the other.
    allowed = np.zeros((FIBERS, 4), dtype=bool)
    allowed[:, 3] = True
    allowed[np.arange(FIBERS), np.arange(FIBERS) % 3] = True
    case = limits(pairs=((0, 1), (2, 3), (4, 5)), budget=None, allowed=allowed, most_lit=2)
    scorer = TableScorer(make_table(FIBERS, 5, 2, 3, 5), limits=case)
    phi = np.full(FIBERS, np.pi / 2)
    fixed = replace(case, low=phi[:, None], high=phi[:, None])
    scorer = TableScorer(scorer.table, limits=fixed)
    best = scorer.scores(EVERY[case.fits(EVERY)], phi).max()
    starts = [scorer.design(phi, row) for row in EVERY[case.fits(EVERY)][1:4]]
    found = multi_start(scorer, NominalScore(scorer), starts)
    assert case.fits(found.design.colors[None])[0]
    assert found.score == pytest.approx(best, rel=1e-6)


def test_a_budget_that_is_met_exactly_is_kept() -> None:
    # 0.1 three times is more than 0.3 in floating point.
    cost = np.tile([0.1, 0.1, 0.1, 0.0], (FIBERS, 1))
    case = replace(unlimited(FIBERS, off=True), budgets=(Budget("search.price", cost, 0.3),))
    lit = (EVERY >= 0).sum(axis=1)
    assert np.array_equal(case.fits(EVERY), lit <= 3)


def test_what_no_coloring_fulfills_names_the_budget() -> None:
    allowed = np.ones((FIBERS, 4), dtype=bool)
    allowed[:, 3] = False
    with pytest.raises(DesignError, match=r"or more of search\.current"):
        limits(budget=0.1, allowed=allowed).nearest_colors(np.zeros((FIBERS, 4)))
