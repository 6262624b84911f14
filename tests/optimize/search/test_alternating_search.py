"""Alternating searches: better than their parts, never worse than the start."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module

import numpy as np
import pytest

from optimize.design import Design
from optimize.scoring import TableScorer
from optimize.search import SearchStep, alternating_search
from optimize.search.colors import ColorResult, exact_colors
from render.transport import TransportTable

MakeTable = Callable[..., TransportTable]
EDGES = ["left"] * 3 + ["tip"] * 3 + ["right"] * 3
START = Design.of_colors(np.full(9, np.pi / 2), np.repeat([0, 2, 1], 3))


def test_it_beats_its_start_and_the_best_colors_alone(make_table: MakeTable) -> None:
    scorer = TableScorer(make_table(9))
    seen: list[SearchStep] = []
    result = alternating_search(scorer, START, edges=EDGES, progress=seen.append)
    assert result.converged
    assert result.score > exact_colors(scorer, START.phi).score
    assert result.score == pytest.approx(scorer.score(result.design.phi, result.design.power))
    assert [step.stage for step in seen[:5]] == ["start", "grouped", "quick", "tied", "free"]
    assert tuple(seen) == result.history
    scores = [step.score for step in seen]
    assert scores == sorted(scores)
    assert result.evaluated == seen[-1].evaluated > 0


def test_after_convergence_another_search_gains_nothing(make_table: MakeTable) -> None:
    scorer = TableScorer(make_table(9))
    first = alternating_search(scorer, START, edges=EDGES)
    again = alternating_search(scorer, first.design, edges=EDGES)
    assert again.score == pytest.approx(first.score, rel=1e-3)
    assert again.score >= first.score


def test_the_same_seed_gives_the_same_design(make_table: MakeTable) -> None:
    scorer = TableScorer(make_table(9))
    first, second = (alternating_search(scorer, START, edges=EDGES, seed=4) for _ in range(2))
    np.testing.assert_array_equal(first.design.phi, second.design.phi)
    np.testing.assert_array_equal(first.design.power, second.design.power)


def test_a_table_with_one_direction_gets_colors_only(make_table: MakeTable) -> None:
    scorer = TableScorer(make_table(9, nodes=1))
    result = alternating_search(scorer, START, edges=EDGES)
    assert {step.stage for step in result.history} == {"start", "grouped", "quick"}
    np.testing.assert_array_equal(result.design.phi, START.phi)
    assert result.score == pytest.approx(exact_colors(scorer, START.phi).score)


def test_without_edges_only_free_directions_are_searched(make_table: MakeTable) -> None:
    result = alternating_search(TableScorer(make_table(9)), START, max_rounds=1)
    assert [step.stage for step in result.history] == ["start", "grouped", "quick", "free"]
    assert not result.converged


def test_a_monochrome_optimum_is_flagged(make_table: MakeTable) -> None:
    result = alternating_search(TableScorer(make_table(9, lam=0.0)), START, max_rounds=1)
    assert result.design.monochrome


def test_a_gain_of_no_more_than_rounding_rewires_nothing(
    make_table: MakeTable, monkeypatch: pytest.MonkeyPatch
) -> None:
    scorer = TableScorer(make_table(9, nodes=1))
    score = scorer.score(START.phi, START.power)

    def hardly_better(*_: object, **__: object) -> ColorResult:
        other = np.roll(START.colors, 1)
        return ColorResult("quick", other, float(np.nextafter(score, np.inf)), 1, 0.0)

    # The package's name is the function's.
    module = import_module("optimize.search.alternating_search")
    monkeypatch.setattr(module, "grouped_colors", hardly_better)
    monkeypatch.setattr(module, "quick_colors", hardly_better)
    result = alternating_search(scorer, START)
    np.testing.assert_array_equal(result.design.colors, START.colors)
    assert result.score == score
