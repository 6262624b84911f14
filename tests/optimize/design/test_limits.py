"""Searches keep to what a builder can make, and lose nothing where it forbids nothing."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from optimize.design import Design, SearchLimits, limits_of, unlimited
from optimize.scoring import TableScorer
from optimize.search import alternating_search, optimize_directions, refine_locally
from optimize.search.colors import exact_colors, grouped_colors, quick_colors
from render.errors import DesignError
from render.scene import (
    Constraints,
    FixedFiber,
    Scene,
    Search,
    load_scene,
    scene_text,
    unchecked,
)
from render.transport import TransportTable

MakeTable = Callable[..., TransportTable]
FIBERS = 7


def limited(
    *, fixed: dict[int, int] | None = None, most: tuple[int, ...] = (9, 9, 9)
) -> SearchLimits:
    allowed = np.ones((FIBERS, 3), dtype=bool)
    for fiber, color in (fixed or {}).items():
        allowed[fiber] = np.arange(3) == color
    return replace(unlimited(FIBERS), allowed=allowed, led_counts=np.array(most))


def best_allowed(scorer: TableScorer, phi: np.ndarray) -> float:
    colors = np.array(list(itertools.product(range(3), repeat=FIBERS)))
    return float(scorer.scores(colors[scorer.limits.fits(colors)], phi).max())


def some_lit(most: int, **given: object) -> SearchLimits:
    """Return limits with off as a choice, of which at most so many are lit."""
    free = unlimited(FIBERS, off=True)
    return replace(free, most_lit=most, **given)


@pytest.mark.parametrize("most", [1, 3, FIBERS])
@pytest.mark.parametrize("leds", [(1, 1, 1), (9, 9, 9), (0, 2, 9)])
def test_searches_light_no_more_than_so_many(
    make_table: MakeTable, most: int, leds: tuple[int, ...]
) -> None:
    limits = some_lit(most, led_counts=np.array([*leds, FIBERS]))
    scorer = TableScorer(make_table(FIBERS, 5, 2, 3, 5), limits=limits)
    phi = np.linspace(0.6, 2.4, FIBERS)
    colors = np.array(list(itertools.product(range(-1, 3), repeat=FIBERS)))
    fits = (colors >= 0).sum(axis=1) <= most
    for color, count in enumerate(leds):
        fits &= (colors == color).sum(axis=1) <= count
    assert np.array_equal(limits.fits(colors), fits)
    best = scorer.scores(colors[fits], phi).max()
    for search in (exact_colors, quick_colors):
        found = search(scorer, phi)
        assert found.score == pytest.approx(best, rel=1e-9)
        assert limits.fits(found.colors[None])[0]


@pytest.mark.parametrize("seed", range(6))
def test_the_nearest_coloring_with_so_many_lit_is_that_of_brute_force(seed: int) -> None:
    rng = np.random.default_rng(seed)
    allowed = rng.uniform(size=(FIBERS, 4)) < 0.8
    allowed[:, -1] = True
    limits = some_lit(3, led_counts=np.array([1, 2, 2, FIBERS]), allowed=allowed)
    preference = rng.normal(size=(FIBERS, 4))
    colors = np.array(list(itertools.product(range(-1, 3), repeat=FIBERS)))
    colors = colors[limits.fits(colors)]
    worth = preference[np.arange(FIBERS), colors].sum(axis=1)
    found = limits.nearest_colors(preference)
    assert limits.fits(found[None])[0]
    assert preference[np.arange(FIBERS), found].sum() == pytest.approx(worth.max())


def test_a_scene_says_how_many_lamps_may_be_lit() -> None:
    scene = unchecked(load_scene("finger20"), {"search": Search.model_construct(lamps=5)})
    limits = limits_of(scene)
    assert (limits.most_lit, limits.may_be_off, limits.some_stay_off) == (5, True, True)
    whole = unchecked(scene, {"search": Search.model_construct(lamps=20)})
    assert not limits_of(whole).may_be_off


@pytest.mark.parametrize(
    "limits",
    [
        limited(),
        limited(most=(2, 3, 4)),
        limited(most=(0, 7, 7)),
        limited(fixed={0: 2, 4: 1}),
        limited(fixed={6: 0, 1: 0}, most=(2, 3, 3)),
    ],
)
def test_searches_find_the_best_allowed_colors(make_table: MakeTable, limits: SearchLimits) -> None:
    scorer = TableScorer(make_table(FIBERS, 5, 2, 3, 5), limits=limits)
    phi = np.linspace(0.6, 2.4, FIBERS)
    best = best_allowed(scorer, phi)
    for search in (exact_colors, quick_colors):
        found = search(scorer, phi)
        assert limits.fits(found.colors[None])[0]
        assert found.score == pytest.approx(best, rel=1e-9)
        assert all(limits.fits(np.array(colors)[None])[0] for colors, _ in found.top)


def test_pairs_keep_to_the_limits(make_table: MakeTable) -> None:
    limits = limited(fixed={0: 2}, most=(3, 3, 3))
    scorer = TableScorer(make_table(FIBERS), limits=limits)
    assert limits.fits(grouped_colors(scorer, scorer.at_node(2)).colors[None])[0]


def test_pairs_that_cannot_be_are_said_to_be_impossible(make_table: MakeTable) -> None:
    limits = limited(fixed=dict(enumerate([0, 1, 2, 0, 1, 2, 0])))
    scorer = TableScorer(make_table(FIBERS), limits=limits)
    with pytest.raises(DesignError, match="no choice of colors"):
        grouped_colors(scorer, scorer.at_node(2))
    start = Design.of_colors(scorer.at_node(2), [0] * FIBERS)
    found = alternating_search(scorer, start)
    assert found.design.colors.tolist() == [0, 1, 2, 0, 1, 2, 0]


def test_contradicting_constraints_are_refused(finger20: Scene) -> None:
    fixed = tuple(FixedFiber(fiber=i, color="red") for i in range(3))
    given = Constraints(max_red=3, max_green=0, max_blue=16, fixed=fixed)
    scene = unchecked(finger20, {"constraints": given})
    with pytest.raises(DesignError, match="constraints"):
        limits_of(scene)


def forbidding(step: float = 0.0) -> SearchLimits:
    low = np.tile([[0.2, 1.8]], (FIBERS, 1))
    high = np.tile([[1.3, 3.0]], (FIBERS, 1))
    low[2], high[2] = 0.9, 0.9
    return replace(unlimited(FIBERS), low=low, high=high, step=step)


@pytest.mark.parametrize("step", [0.0, math.radians(5.0)])
def test_directions_stay_where_they_can_be_mounted(make_table: MakeTable, step: float) -> None:
    limits = forbidding(step)
    scorer = TableScorer(make_table(FIBERS), limits=limits)
    power = np.eye(3)[np.arange(FIBERS) % 3]
    found = optimize_directions(
        lambda phi: scorer.direction_scores(phi, power),
        np.full(FIBERS, 1.5),
        bounds=scorer.phi_bounds,
        limits=limits,
    )
    inside = (limits.low <= found.phi[:, None] + 1e-9) & (found.phi[:, None] <= limits.high + 1e-9)
    assert inside.any(axis=1).all()
    assert found.phi[2] == 0.9
    assert found.score == pytest.approx(scorer.score(found.phi, power), rel=1e-12)
    if step:
        steps = np.delete(found.phi, 2) / step
        assert steps == pytest.approx(steps.round(), abs=1e-9)
        free = replace(limits, step=0.0)
        better = optimize_directions(
            lambda phi: scorer.direction_scores(phi, power),
            np.full(FIBERS, 1.5),
            bounds=scorer.phi_bounds,
            limits=free,
        )
        assert better.score >= found.score - 1e-9
        for fiber in range(FIBERS):  # no single step is better
            for move in (-step, step):
                moved = found.phi.copy()
                moved[fiber] = np.clip(moved[fiber] + move, 0.0, math.pi)
                moved = limits.nearest_directions(moved)
                assert scorer.score(moved, power) <= found.score + 1e-9


def test_no_limit_changes_nothing(make_table: MakeTable) -> None:
    plain, open_ = (
        TableScorer(make_table(FIBERS)),
        TableScorer(make_table(FIBERS), limits=unlimited(FIBERS)),
    )
    start = Design.of_colors(plain.at_node(2), [0, 0, 1, 1, 2, 2, 2])
    first, second = (alternating_search(scorer, start, seed=3) for scorer in (plain, open_))
    assert first.score == second.score
    assert first.design.phi.tolist() == second.design.phi.tolist()


def test_continuous_power_never_loses_and_keeps_to_the_limit(make_table: MakeTable) -> None:
    limits = replace(unlimited(FIBERS), led_power=np.array([0.8, 0.9, 0.7]), continuous_power=True)
    scorer = TableScorer(make_table(FIBERS), limits=limits)
    start = Design(scorer.at_node(2), scorer.power(np.arange(FIBERS) % 3))
    found = alternating_search(scorer, start)
    assert found.history[-1].stage == "power"
    assert found.score >= found.history[-2].score
    assert (found.design.power <= limits.led_power + 1e-12).all()
    assert ((found.design.power > 0).sum(axis=1) <= 1).all()


def test_local_refinement_climbs_from_any_start(make_table: MakeTable) -> None:
    scorer = TableScorer(make_table(FIBERS))
    start = Design.of_colors(np.full(FIBERS, 0.4), np.arange(FIBERS) % 3)
    found = refine_locally(scorer, start)
    assert found.score > scorer.score(start.phi, start.power)
    assert found.score == scorer.score(found.design.phi, found.design.power)
    again = refine_locally(scorer, found.design)
    assert again.score == pytest.approx(found.score, rel=1e-6)


def held(more: str, tmp_path: Path, thickness: float = 8.0) -> Scene:
    """Return a sensor of eight fibers in a thick holder, so that many directions meet."""
    text = scene_text("finger20")
    for edge, old, new in (("left", 8, 3), ("tip", 4, 2), ("right", 8, 3)):
        text = text.replace(f"{edge} = {old}", f"{edge} = {new}")
    path = tmp_path / "held.toml"
    holder = f'{{ value = {thickness}, unit = "mm", source = "drawing" }}'
    path.write_text(f"{text}\n[constraints]\nholder_thickness = {holder}\n{more}")
    return load_scene(path)


@pytest.mark.parametrize("step", ["", 'angle_step = { value = 15.0, unit = "deg", source = "x" }'])
def test_fibers_that_would_meet_are_turned_until_they_do_not(step: str, tmp_path: Path) -> None:
    limits = limits_of(held(step, tmp_path))
    assert limits.holder is not None
    asked = np.random.default_rng(2).uniform(0.0, np.pi, (200, 8))
    given = limits.nearest_directions(asked)
    assert (limits.holder.slack(given) >= 0).all()
    assert limits.nearest_directions(given).tolist() == given.tolist()
    if step:
        assert given / np.radians(15.0) == pytest.approx((given / np.radians(15.0)).round())
    else:
        free = (limits.holder.slack(asked) >= 0).all(axis=1)
        assert 0 < free.sum() < 200
        assert given[free].tolist() == asked[free].tolist()


def test_fixed_fibers_that_meet_contradict_each_other(tmp_path: Path) -> None:
    fixed = "".join(
        f"[[constraints.fixed]]\nfiber = {fiber}\n"
        f'angle = {{ value = {angle}, unit = "deg", source = "mounted" }}\n'
        for fiber, angle in ((0, 150.0), (1, 30.0))
    )
    with pytest.raises(DesignError, match="fibers 0 and 1 at 150 and 30 deg"):
        limits_of(held(fixed, tmp_path))


def test_a_search_finds_the_best_design_whose_fibers_do_not_meet(
    make_table: MakeTable, tmp_path: Path
) -> None:
    limits = limits_of(held("", tmp_path, thickness=20.0))
    assert limits.holder is not None
    table = make_table(8)
    start = Design.of_colors(np.full(8, np.pi / 2), np.arange(8) % 3)
    free = alternating_search(TableScorer(table), start, edges=None)
    found = alternating_search(TableScorer(table, limits=limits), start, edges=None)
    assert limits.holder.slack(free.design.phi).min() < 0  # or there is nothing to test
    assert limits.holder.slack(found.design.phi).min() >= 0
    assert start_score(table, start) < found.score < free.score
    # Of the same colors, no allowed neighbor of it is better.
    rng = np.random.default_rng(0)
    scorer = TableScorer(table, limits=limits)
    near = limits.nearest_directions(
        np.clip(found.design.phi + rng.normal(0.0, 0.02, (200, 8)), 0.0, np.pi)
    )
    best = max(scorer.score(phi, found.design.power) for phi in near)
    assert best <= found.score + 1e-3 * abs(found.score)


def start_score(table: TransportTable, start: Design) -> float:
    return TableScorer(table).score(start.phi, start.power)
