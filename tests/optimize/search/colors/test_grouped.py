"""The thesis's pair grouping, for even and odd numbers of fibers."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
import pytest

from optimize.scoring import TableScorer
from optimize.search.colors import grouped_colors
from optimize.search.colors.grouped import pair_groups, repair_boundaries
from render.transport import TransportTable

MakeTable = Callable[..., TransportTable]


def best_of_pairs(scorer: TableScorer, phi: np.ndarray) -> tuple[float, np.ndarray]:
    candidates = []
    for phase in (0, 1):
        groups = pair_groups(scorer.fibers, phase)
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
        assert np.bincount(pair_groups(fibers, phase)).max() <= 2


def test_twenty_fibers_make_ten_pairs_in_both_phases() -> None:
    for phase in (0, 1):
        assert np.bincount(pair_groups(20, phase)).tolist() == [2] * 10


def test_repair_reaches_odd_groups(make_table: MakeTable) -> None:
    scorer = TableScorer(make_table(9, lam=60.0))
    phi = scorer.at_node(2)
    odd = np.array([0, 0, 0, 1, 1, 1, 2, 2, 2])
    pairs = np.array([0, 0, 1, 1, 1, 1, 2, 2, 2])
    _, score, tried = repair_boundaries(scorer, phi, pairs)
    assert score >= scorer.scores(odd[None], phi)[0]
    assert tried > 1
