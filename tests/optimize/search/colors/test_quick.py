"""The 2-opt search: local optimality, agreement with the exact one, repeatability."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
import pytest

from optimize.scoring import TableScorer
from optimize.search.colors import exact_colors, quick_colors
from render.progress import Progress
from render.transport import TransportTable

MakeTable = Callable[..., TransportTable]


@pytest.mark.parametrize("fibers", [1, 2, 6, 9, 12])
def test_it_finds_the_exact_optimum_of_small_sensors(make_table: MakeTable, fibers: int) -> None:
    scorer = TableScorer(make_table(fibers, lam=60.0))
    phi = scorer.at_node(2)
    exact, quick = exact_colors(scorer, phi), quick_colors(scorer, phi)
    assert quick.score == pytest.approx(exact.score, rel=1e-12)
    assert quick.score == scorer.score(phi, scorer.power(quick.colors))


def test_no_two_recolored_fibers_improve_it(make_table: MakeTable) -> None:
    scorer = TableScorer(make_table(7, lam=60.0))
    phi = scorer.at_node(1)
    result = quick_colors(scorer, phi, restarts=1, seed=3)
    rivals = []
    for first, second in itertools.combinations(range(7), 2):
        for new in itertools.product(range(3), repeat=2):
            rival = result.colors.copy()
            rival[[first, second]] = new
            rivals.append(rival)
    assert scorer.scores(np.array(rivals), phi).max() <= result.score * (1 + 1e-11)


def test_the_same_seed_gives_the_same_result(make_table: MakeTable) -> None:
    scorer = TableScorer(make_table(10))
    phi = scorer.at_node(2)
    first, second = (quick_colors(scorer, phi, restarts=3, seed=5) for _ in range(2))
    assert first.colors.tolist() == second.colors.tolist()
    assert (first.score, first.evaluated) == (second.score, second.evaluated)


def test_it_never_ends_below_a_given_start(make_table: MakeTable) -> None:
    scorer = TableScorer(make_table(10))
    phi = scorer.at_node(2)
    start = exact_colors(scorer, phi)
    result = quick_colors(scorer, phi, starts=[start.colors], restarts=0)
    assert result.colors.tolist() == start.colors.tolist()


def test_unequal_leds_are_respected(make_table: MakeTable) -> None:
    scorer = TableScorer(make_table(7, lam=0.0), led_power=np.array([0.2, 0.3, 1.0]))
    phi = scorer.at_node(2)
    result = quick_colors(scorer, phi)
    assert result.monochrome
    assert result.colors.tolist() == exact_colors(scorer, phi).colors.tolist() == [2] * 7


def test_progress_counts_the_starts(make_table: MakeTable) -> None:
    seen: list[Progress] = []
    scorer = TableScorer(make_table(4))
    quick_colors(scorer, scorer.at_node(0), restarts=2, progress=seen.append)
    assert [(at.done, at.total) for at in seen] == [(1, 2), (2, 2)]
