"""Scores on a table: the fast paths equal the metric, and what the table lacks is refused."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from optimize.scoring import TableScorer
from render.errors import TableError
from render.metric import MetricConfig, design_score, image_counts, site_metric
from render.transport import TransportTable

MakeTable = Callable[..., TransportTable]


def test_the_score_is_the_metric_of_superposed_light(make_table: MakeTable) -> None:
    table = make_table()
    rng = np.random.default_rng(1)
    phi, power = np.pi * rng.random(8), rng.random((8, 3))
    metric = site_metric(image_counts(table.at(phi), power, table.exposure), table.lam)
    details = TableScorer(table).details(phi, power)
    np.testing.assert_allclose(details.metric, metric, rtol=1e-12)
    assert details.score == pytest.approx(float(design_score(metric).score))
    assert details.score == pytest.approx(
        details.mean - details.spread_sites - details.spread_bends
    )
    assert 0.0 <= details.clipped <= 1.0


def test_many_colors_and_directions_score_as_one_by_one(make_table: MakeTable) -> None:
    scorer = TableScorer(make_table(), led_power=np.array([1.0, 0.8, 0.5]))
    rng = np.random.default_rng(2)
    colors = rng.integers(0, 3, (150, 8))
    phi = np.pi * rng.random((150, 8))
    np.testing.assert_allclose(
        scorer.scores(colors, phi[0]),
        [scorer.score(phi[0], scorer.power(row)) for row in colors],
        rtol=1e-12,
    )
    power = rng.random((8, 3)) * (rng.random((8, 3)) < 0.6)
    np.testing.assert_allclose(
        scorer.direction_scores(phi, power),
        [scorer.score(row, power) for row in phi],
        rtol=1e-10,
    )


def test_no_light_scores_zero(make_table: MakeTable) -> None:
    scorer = TableScorer(make_table())
    dark = np.zeros((8, 3))
    assert scorer.score(scorer.at_node(0), dark) == 0.0
    assert scorer.direction_scores(scorer.at_node(0)[None], dark).tolist() == [0.0]


def test_colors_are_exchangeable_only_with_equal_led_powers(make_table: MakeTable) -> None:
    table = make_table()
    assert TableScorer(table).colors_alike
    assert TableScorer(table, led_power=np.tile(np.linspace(0, 1, 8)[:, None], 3)).colors_alike
    assert not TableScorer(table, led_power=np.array([1.0, 1.0, 0.9])).colors_alike


def test_directions_outside_the_table_are_refused(make_table: MakeTable) -> None:
    scorer = TableScorer(make_table())
    for angle in (-0.1, 3.2, np.nan):
        with pytest.raises(TableError, match=r"phi = .* rad, allowed: 0 to 3.14159 rad"):
            scorer.light(np.full(8, angle))
    with pytest.raises(TableError, match="allowed: 8 directions"):
        scorer.light(np.zeros(7))


def test_a_table_with_one_direction_covers_that_direction_only(make_table: MakeTable) -> None:
    scorer = TableScorer(make_table(nodes=1))
    assert scorer.light(scorer.at_node(0)).shape == (8, 2, 4, 6)
    with pytest.raises(TableError, match=r"allowed: 1\.5708 to 1\.5708 rad"):
        scorer.light(np.zeros(8))
    with pytest.raises(TableError, match="phi index 1, allowed: 0 to 0"):
        scorer.at_node(1)


def test_bad_led_powers_and_unfit_conventions_are_refused(make_table: MakeTable) -> None:
    with pytest.raises(TableError, match="led_power"):
        TableScorer(make_table(), led_power=np.array([1.0, 1.0, 1.1]))
    with pytest.raises(TableError, match="ddof = 1 is undefined"):
        TableScorer(make_table(bends=1), MetricConfig(ddof=1))
