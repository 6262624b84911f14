"""The thesis's pair grouping, for even and odd numbers of fibers."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
import pytest

from optimize.scoring import TableScorer
from optimize.search.colors import grouped_colors
from optimize.search.colors.grouped import (
    MAX_ASSIGNMENTS,
    group_size,
    neighbor_groups,
    repair_boundaries,
)
from render.transport import TransportTable

MakeTable = Callable[..., TransportTable]


def best_of_pairs(scorer: TableScorer, phi: np.ndarray) -> tuple[float, np.ndarray]:
    candidates = []
    for phase in (0, 1):
        groups = neighbor_groups(scorer.fibers, phase)
        for choice in itertools.product(range(3), repeat=int(groups.max()) + 1):
            candidates.append(np.array(choice)[groups])
    scores = scorer.scores(np.array(candidates), phi)
    return float(scores.max()), candidates[int(scores.argmax())]


@pytest.mark.parametrize("fibers", [1, 2, 3, 7, 8, 11])
def test_it_is_the_repaired_best_of_both_phases(make_table: MakeTable, fibers: int) -> None:
    scorer = TableScorer(make_table(fibers, lam=60.0))
    phi = scorer.at_node(2)
    result = grouped_colors(scorer, phi)
    pairs, colors = best_of_pairs(scorer, phi)
    assert result.score >= pairs * (1 - 1e-12)
    assert result.score == pytest.approx(repair_boundaries(scorer, phi, colors)[1], rel=1e-12)
    assert result.score == pytest.approx(scorer.score(phi, scorer.power(result.colors)))


@pytest.mark.parametrize("fibers", [1, 2, 5, 6])
def test_every_group_has_at_most_two_fibers(fibers: int) -> None:
    for phase in (0, 1):
        assert np.bincount(neighbor_groups(fibers, phase)).max() <= 2


def test_twenty_fibers_make_ten_pairs_in_both_phases() -> None:
    for phase in (0, 1):
        assert np.bincount(neighbor_groups(20, phase)).tolist() == [2] * 10


@pytest.mark.parametrize(("fibers", "choices"), [(20, 3), (24, 3), (28, 3), (20, 4), (16, 6)])
def test_groups_are_pairs_where_these_have_few_assignments(fibers: int, choices: int) -> None:
    assert group_size(fibers, choices, symmetric=False) == 2


@pytest.mark.parametrize(("fibers", "choices"), [(48, 3), (24, 6), (30, 4), (7, 500), (200, 2)])
def test_groups_are_larger_where_pairs_would_never_end(fibers: int, choices: int) -> None:
    size = group_size(fibers, choices, symmetric=False)
    assert size > 2
    for phase in (0, 1):
        groups = neighbor_groups(fibers, phase, size)
        assert np.bincount(groups).max() <= size
        assert choices ** (int(groups.max()) + 1) <= MAX_ASSIGNMENTS


def test_many_fibers_are_colored_in_larger_groups_and_it_is_said(make_table: MakeTable) -> None:
    scorer = TableScorer(make_table(48, lam=60.0))
    phi = scorer.at_node(2)
    result = grouped_colors(scorer, phi)
    assert result.method == "coarsely grouped"
    assert result.evaluated < 2 * MAX_ASSIGNMENTS + 10_000
    assert result.score == pytest.approx(scorer.score(phi, scorer.power(result.colors)))


def test_repair_reaches_odd_groups(make_table: MakeTable) -> None:
    scorer = TableScorer(make_table(9, lam=60.0))
    phi = scorer.at_node(2)
    odd = np.array([0, 0, 0, 1, 1, 1, 2, 2, 2])
    pairs = np.array([0, 0, 1, 1, 1, 1, 2, 2, 2])
    _, score, tried = repair_boundaries(scorer, phi, pairs)
    assert score >= scorer.scores(odd[None], phi)[0]
    assert tried > 1
