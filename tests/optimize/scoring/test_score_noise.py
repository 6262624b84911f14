"""Error bars of scores: against linear propagation, and ties."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from optimize.scoring import TableScorer, score_draws, score_interval, tied
from render.transport import TransportTable

MakeTable = Callable[..., TransportTable]


def lighting(scorer: TableScorer) -> tuple[np.ndarray, np.ndarray]:
    colors = np.arange(scorer.fibers) * 3 // scorer.fibers
    return np.full(scorer.fibers, 1.0), scorer.power(colors)


def test_small_errors_spread_the_score_as_linear_propagation_says(make_table: MakeTable) -> None:
    table = make_table(fibers=3, nodes=3, bends=1, sites=2, facets=4, error=1e-4)
    scorer = TableScorer(table)
    phi, power = lighting(scorer)
    variance = 0.0
    for cell in np.ndindex(table.T.shape):
        moved = table.T.copy()
        moved[cell] += table.se[cell]
        variance += (
            TableScorer(replace(table, T=moved)).score(phi, power) - scorer.score(phi, power)
        ) ** 2
    drawn = score_draws(scorer, phi, power[None], draws=1000)
    assert drawn.std() == pytest.approx(np.sqrt(variance), rel=0.1)


def test_errors_shared_by_a_fiber_do_not_average_out(make_table: MakeTable) -> None:
    spreads = []
    for level in ("reference", "surrogate"):
        scorer = TableScorer(make_table(sites=15, facets=10, error=0.01, level=level))
        phi, power = lighting(scorer)
        spreads.append(float(score_draws(scorer, phi, power[None]).std()))
    assert spreads[1] > 1.5 * spreads[0]


def test_the_interval_contains_the_score_and_repeats_exactly(make_table: MakeTable) -> None:
    scorer = TableScorer(make_table(error=0.05))
    phi, power = lighting(scorer)
    low, high = score_interval(scorer, phi, power)
    assert low < scorer.score(phi, power) < high
    assert (low, high) == score_interval(scorer, phi, power)


def test_without_errors_the_interval_has_no_width(make_table: MakeTable) -> None:
    scorer = TableScorer(make_table())
    phi, power = lighting(scorer)
    assert score_interval(scorer, phi, power) == (scorer.score(phi, power),) * 2


def test_noise_lowers_scores(make_table: MakeTable) -> None:
    scorer = TableScorer(make_table(error=0.1))
    phi, power = lighting(scorer)
    assert score_draws(scorer, phi, power[None]).mean() < scorer.score(phi, power)


def test_renamed_colors_tie_and_a_dim_lighting_does_not(make_table: MakeTable) -> None:
    for error in (0.0, 0.01):
        scorer = TableScorer(make_table(error=error))
        phi, best = lighting(scorer)
        rivals = np.stack([best, best[:, [1, 2, 0]], 0.3 * best])
        assert tied(scorer, phi, rivals).tolist() == [True, True, False]


def test_lightings_that_differ_by_less_than_the_errors_tie(make_table: MakeTable) -> None:
    for error, tie in ((0.0, False), (0.01, True)):
        table = make_table(error=error)
        transport = table.T.copy()
        transport[1] = 1.001 * transport[0]  # twins, up to a tenth of the error
        scorer = TableScorer(replace(table, T=transport))
        phi, first = lighting(scorer)
        first[:2] = np.eye(3)[[0, 1]]
        both = np.stack([first, first[[1, 0, *range(2, 8)]]])
        order = np.argsort([-scorer.score(phi, power) for power in both])
        assert tied(scorer, phi, both[order]).tolist() == [True, tie]
