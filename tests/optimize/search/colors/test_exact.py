"""The exact search equals brute force, and says what it knows about ties."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from optimize.scoring import TableScorer
from optimize.search.colors import exact_colors
from render.errors import TableError, TactiluxError
from render.metric import clip_counts, design_score, image_counts, site_metric
from render.progress import Progress
from render.transport import TransportTable

MakeTable = Callable[..., TransportTable]


def brute_force(scorer: TableScorer, phi: np.ndarray) -> tuple[float, np.ndarray]:
    colors = np.array(list(itertools.product(range(3), repeat=scorer.fibers)))
    table, best = scorer.table, []
    for part in np.array_split(colors, -(-len(colors) // 5000)):
        if table.by_channel:
            light = table.exposure * table.at(phi)
            mixed = np.einsum("fbskc,nfc->nbskc", light, scorer.power(part))
            counts = clip_counts(mixed, scorer.config)
        else:
            counts = image_counts(table.at(phi), scorer.power(part), table.exposure, scorer.config)
        metric = site_metric(counts, table.lam, scorer.config)
        score = design_score(metric, scorer.config).score
        best.append((float(score.max()), part[score.argmax()]))
    return max(best, key=lambda item: item[0])


@pytest.mark.parametrize(
    ("fibers", "bends", "sites", "facets"),
    [(1, 1, 1, 3), (2, 3, 2, 4), (5, 1, 6, 10), (7, 2, 3, 6), (9, 2, 4, 5), (10, 2, 3, 4)],
)
def test_it_equals_brute_force(
    make_table: MakeTable, fibers: int, bends: int, sites: int, facets: int
) -> None:
    table = make_table(fibers, 3, bends, sites, facets, lam=60.0, seed=fibers)
    scorer = TableScorer(table)
    phi = np.linspace(0.5, 2.5, fibers)
    result = exact_colors(scorer, phi)
    score, _ = brute_force(scorer, phi)
    assert result.score == pytest.approx(score, rel=1e-12)
    assert scorer.score(phi, scorer.power(result.colors)) == result.score


def test_ten_fibers_need_a_sixth_of_the_evaluations(make_table: MakeTable) -> None:
    scorer = TableScorer(make_table(11, sites=2, bends=1, facets=3))
    result = exact_colors(scorer, scorer.at_node(0))
    assert result.evaluated == 2 * 3**9  # prefixes (0 0) and (0 1)
    assert result.colors[0] == 0


def test_different_led_powers_switch_the_symmetry_off(make_table: MakeTable) -> None:
    led_power = np.array([0.4, 1.0, 0.7])
    scorer = TableScorer(make_table(10, 3, 2, 2, 4, lam=60.0), led_power=led_power)
    phi = scorer.at_node(1)
    result = exact_colors(scorer, phi)
    score, colors = brute_force(scorer, phi)
    assert result.evaluated == 3**10
    assert result.score == pytest.approx(score, rel=1e-12)
    assert result.colors.tolist() == colors.tolist()


def test_materials_that_depend_on_the_channel_switch_the_symmetry_off(
    make_table: MakeTable,
) -> None:
    table = make_table(10, 3, 2, 2, 4, lam=60.0)
    tint = np.random.default_rng(0).uniform(0.4, 1.0, (*table.T.shape[2:], 3))
    light = table.T[..., None] * tint
    scorer = TableScorer(replace(table, T=light, se=0.01 * light))
    phi = scorer.at_node(1)
    result = exact_colors(scorer, phi)
    score, colors = brute_force(scorer, phi)
    assert result.evaluated == 3**10
    assert result.score == pytest.approx(score, rel=1e-12)
    assert result.colors.tolist() == colors.tolist()
    power = scorer.power(result.colors)
    assert scorer.direction_scores(phi[None], power)[0] == pytest.approx(score, rel=1e-12)
    gray = replace(table, T=np.repeat(table.T[..., None], 3, axis=-1),
                   se=np.zeros((*table.T.shape, 3)))  # fmt: skip
    plain, tinted = TableScorer(table), TableScorer(gray)
    assert exact_colors(tinted, phi).score == pytest.approx(exact_colors(plain, phi).score)


def test_the_list_of_the_best_is_in_order_and_scored_in_float64(make_table: MakeTable) -> None:
    scorer = TableScorer(make_table(8))
    found = exact_colors(scorer, scorer.at_node(2))
    scores = [score for _, score in found.top]
    assert found.top[0] == (tuple(found.colors.tolist()), pytest.approx(found.score))
    assert scores == sorted(scores, reverse=True)
    assert len(found.top) > 20
    again = scorer.scores(np.array([colors for colors, _ in found.top]), scorer.at_node(2))
    assert again.tolist() == scores


def test_two_identical_fibers_make_an_exact_tie(make_table: MakeTable) -> None:
    table = make_table(6)
    transport = table.T.copy()
    transport[1] = transport[0]
    scorer = TableScorer(replace(table, T=transport))
    phi = np.full(6, 1.0)
    result = exact_colors(scorer, phi)
    mirrored = result.colors[[1, 0, 2, 3, 4, 5]]
    if result.colors[0] != result.colors[1]:
        assert len(result.ties) == 1
        assert scorer.score(phi, scorer.power(mirrored)) == pytest.approx(result.score, rel=1e-12)
    else:
        assert result.ties == ()


def test_large_errors_make_more_ties(make_table: MakeTable) -> None:
    ties = []
    for error in (0.0, 0.02, 0.3):
        scorer = TableScorer(make_table(8, error=error))
        ties.append(len(exact_colors(scorer, scorer.at_node(2)).ties))
    assert ties[0] <= ties[1] < ties[2]


def test_when_all_assignments_tie_it_says_that_there_may_be_more(make_table: MakeTable) -> None:
    dark = make_table(10, lam=1.0)
    scorer = TableScorer(replace(dark, T=np.zeros_like(dark.T), se=np.zeros_like(dark.T)))
    result = exact_colors(scorer, scorer.at_node(0))
    assert result.score == 0.0
    assert not result.ties_complete


def test_a_heavy_weight_on_brightness_gives_one_color_and_says_so(make_table: MakeTable) -> None:
    scorer = TableScorer(make_table(7, lam=0.0))
    assert exact_colors(scorer, scorer.at_node(2)).monochrome
    assert not exact_colors(TableScorer(make_table(7)), scorer.at_node(2)).monochrome


def test_progress_reaches_the_total(make_table: MakeTable) -> None:
    seen: list[Progress] = []
    scorer = TableScorer(make_table(12, sites=1, bends=1, facets=3))
    result = exact_colors(scorer, scorer.at_node(0), seen.append)
    assert seen[-1].done == seen[-1].total == result.evaluated
    assert seen[-1].eta_seconds == 0.0
    assert seen[-1].seconds > 0.0


def test_hopeless_and_overflowing_searches_are_refused(make_table: MakeTable) -> None:
    many = TableScorer(make_table(27, nodes=1, sites=1, bends=1, facets=3))
    with pytest.raises(TactiluxError, match="allowed: at most 26; use the method quick"):
        exact_colors(many, many.at_node(0))
    bright = TableScorer(replace(make_table(4), exposure=1e60))
    with pytest.raises(TableError, match="exceeds the range of float32"):
        exact_colors(bright, bright.at_node(0))
