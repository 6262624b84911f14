"""Derivatives of the score equal finite differences, everywhere that it is smooth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from optimize.scoring import ScoreMerit, TableScorer
from render.metric import MetricConfig
from render.transport import TransportTable

MakeTable = Callable[..., TransportTable]


@pytest.mark.parametrize(
    "config", [MetricConfig(), MetricConfig(ddof=1), MetricConfig(cyclic=False)]
)
@pytest.mark.parametrize("brighter", [1.0, 1.6])
def test_they_equal_finite_differences(
    make_table: MakeTable, config: MetricConfig, brighter: float
) -> None:
    table = make_table(6, 7, 3, 4, 6)
    scorer = TableScorer(replace(table, exposure=brighter * table.exposure), config)
    rng = np.random.default_rng(3)
    phi, power = rng.uniform(0.3, 2.8, 6), rng.uniform(0.2, 0.9, (6, 3))
    found = ScoreMerit(scorer).gradient(phi, power)
    assert found.value == pytest.approx(scorer.score(phi, power), rel=1e-12)
    h = 1e-6
    for fiber in range(6):
        step = h * np.eye(6)[fiber]
        slope = (scorer.score(phi + step, power) - scorer.score(phi - step, power)) / (2 * h)
        assert found.phi[fiber] == pytest.approx(slope, rel=1e-4, abs=1e-4)
        for color in range(3):
            move = np.zeros((6, 3))
            move[fiber, color] = h
            slope = (scorer.score(phi, power + move) - scorer.score(phi, power - move)) / (2 * h)
            assert found.power[fiber, color] == pytest.approx(slope, rel=1e-4, abs=1e-4)


def test_light_says_what_a_relative_change_of_cells_does(make_table: MakeTable) -> None:
    scorer = TableScorer(make_table(5, 5, 2, 3, 5))
    phi, power = np.full(5, 1.2), np.eye(3)[[0, 1, 2, 0, 1]]
    trend = np.random.default_rng(1).standard_normal((5, 2, 3, 5))
    exact, h = ScoreMerit(scorer), 1e-6
    light = [exact.light(phi) * np.exp(sign * h * trend) for sign in (1, -1)]
    ends = exact.values(np.stack([exact.superposed(one, power) for one in light]))
    slope = (ends[0] - ends[1]) / (2 * h)
    assert (exact.gradient(phi, power).light * trend).sum() == pytest.approx(slope, rel=1e-6)


def test_darkness_has_derivative_zero_and_no_nan(make_table: MakeTable) -> None:
    table = make_table(4)
    scorer = TableScorer(replace(table, T=np.zeros_like(table.T)))
    found = ScoreMerit(scorer).gradient(np.full(4, 1.0), np.eye(3)[[0, 1, 2, 0]])
    assert found.value == 0.0
    assert not found.phi.any()
    assert np.isfinite(found.power).all()
