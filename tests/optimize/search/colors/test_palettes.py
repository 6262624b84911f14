"""LEDs of any color: searches equal brute force with responses, off and any number of channels."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from optimize.design import Colors, Design, SearchLimits, unlimited
from optimize.scoring import TableScorer
from optimize.search import alternating_search
from optimize.search.colors import exact_colors, grouped_colors, quick_colors
from render.metric import clip_counts, design_score, site_metric
from render.scene import RGB, Palette
from render.transport import TransportTable

pytestmark = pytest.mark.slow

MakeTable = Callable[..., TransportTable]
MONO = Palette(("white", "infrared"), ((1.0,), (0.4,)), ("gray",), ("#000000",) * 2)
AMBER = Palette(
    ("red", "white", "amber", "blue"),
    ((1.0, 0.02, 0.0), (0.8, 1.0, 0.6), (1.0, 0.45, 0.0), (0.0, 0.1, 0.9)),
    RGB.channels,
    ("#000000",) * 4,
)
SIX = Palette(
    tuple(f"light-{i}" for i in range(6)),
    tuple(tuple(float(i == j) for j in range(6)) for i in range(6)),
    tuple(f"frame-{i}" for i in range(6)),
    ("#000000",) * 6,
)
CASES = [(MONO, 7), (AMBER, 5), (SIX, 4), (RGB, 6)]


def scorer_of(make_table: MakeTable, limits: SearchLimits, lam: float = 40.0) -> TableScorer:
    table = make_table(len(limits.allowed), 3, 2, 3, 5, lam=lam, seed=3)
    return TableScorer(table, limits=limits)


def formula(scorer: TableScorer, phi: np.ndarray, colors: Colors) -> float:
    """S of one coloring from the palette's own numbers, fiber by fiber."""
    palette, light = scorer.palette, scorer.table.exposure * scorer.table.at(phi)
    counts = np.zeros((*light.shape[1:], len(palette.channels)))
    for fiber, color in enumerate(colors):
        if color >= 0:
            power = scorer.limits.led_power[color]
            for channel, seen in enumerate(palette.response[color]):
                counts[..., channel] += power * seen * light[fiber]
    metric = site_metric(clip_counts(counts), scorer.table.lam)
    return float(design_score(metric).score)


def brute_force(scorer: TableScorer, phi: np.ndarray) -> float:
    choices = [*range(len(scorer.palette.names)), *([-1] if scorer.limits.may_be_off else [])]
    every = np.array(list(itertools.product(choices, repeat=scorer.fibers)))
    return max(formula(scorer, phi, row) for row in every if scorer.limits.fits(row[None])[0])


@pytest.mark.parametrize("off", [False, True])
@pytest.mark.parametrize(("palette", "fibers"), CASES)
def test_the_exact_search_equals_brute_force(
    make_table: MakeTable, palette: Palette, fibers: int, off: bool
) -> None:
    limits = unlimited(fibers - off, palette, off=off)
    power = np.linspace(1.0, 0.7, len(palette.names))
    scorer = scorer_of(make_table, replace(limits, led_power=power))
    phi = np.linspace(0.5, 2.5, scorer.fibers)
    found = exact_colors(scorer, phi)
    assert found.score == pytest.approx(brute_force(scorer, phi), rel=1e-12)
    assert found.score == pytest.approx(formula(scorer, phi, found.colors), rel=1e-12)
    quick = quick_colors(scorer, phi, restarts=12)
    assert quick.score == pytest.approx(formula(scorer, phi, quick.colors), rel=1e-12)
    assert quick.score == pytest.approx(found.score, rel=1e-9)


def test_limits_count_leds_of_every_color_and_leave_off_free(make_table: MakeTable) -> None:
    limits = unlimited(5, AMBER, off=True)
    allowed = limits.allowed.copy()
    allowed[2] = np.arange(5) == 4  # off
    limits = replace(limits, allowed=allowed, led_counts=np.array([1, 1, 0, 1, 5]))
    scorer = scorer_of(make_table, limits)
    phi = scorer.at_node(1)
    found = exact_colors(scorer, phi)
    assert found.colors[2] == -1
    assert (found.colors == -1).sum() >= 2  # three LEDs for five fibers
    assert found.score == pytest.approx(brute_force(scorer, phi), rel=1e-12)
    assert limits.fits(quick_colors(scorer, phi).colors[None])[0]
    assert limits.fits(grouped_colors(scorer, phi).colors[None])[0]


def test_a_dark_fiber_can_be_better_than_any_color(make_table: MakeTable) -> None:
    # One fiber lights the brightest site alone: with it the sites differ more.
    table = make_table(6, 1, 1, 4, 5, lam=0.0, seed=1)
    T = table.T.copy()
    others = np.delete(T, 3, axis=0).sum(axis=(0, 1, 2, 4))
    T[3] *= (10.0 * (others == others.max()))[:, None]
    table = replace(table, T=T, exposure=0.2 * table.exposure)
    phi, power = table.phi.repeat(6), np.ones(2)
    lit = TableScorer(table, limits=replace(unlimited(6, MONO), led_power=power))
    dark = TableScorer(table, limits=replace(unlimited(6, MONO, off=True), led_power=power))
    assert exact_colors(dark, phi).colors[3] == -1
    assert exact_colors(dark, phi).score > exact_colors(lit, phi).score


def test_renaming_channels_changes_nothing(make_table: MakeTable) -> None:
    order = [2, 0, 1]
    turned = replace(AMBER, response=tuple(tuple(row[c] for c in order) for row in AMBER.response))
    scorers = [scorer_of(make_table, unlimited(6, palette)) for palette in (AMBER, turned)]
    first, second = (exact_colors(scorer, scorer.at_node(1)) for scorer in scorers)
    assert first.score == pytest.approx(second.score, rel=1e-12)
    np.testing.assert_array_equal(first.colors, second.colors)


def test_leds_named_as_by_default_give_the_same_bits(make_table: MakeTable) -> None:
    said = Palette(("a", "b", "c"), RGB.response, ("x", "y", "z"), RGB.inks)
    results = []
    for palette in (RGB, said):
        scorer = scorer_of(make_table, unlimited(7, palette))
        start = Design.of_colors(scorer.at_node(1), [0, 0, 1, 1, 2, 2, 2], palette)
        found = alternating_search(scorer, start, max_rounds=2)
        results.append((found.score, found.design.phi.tobytes(), found.design.power.tobytes()))
    assert results[0] == results[1]


def test_a_mono_camera_has_no_hue_to_search_for(make_table: MakeTable) -> None:
    scores = [
        exact_colors(scorer_of(make_table, unlimited(6, MONO), lam), np.full(6, 1.2)).score
        for lam in (0.0, 50.0)
    ]
    assert scores[0] == pytest.approx(scores[1], rel=1e-9)


@pytest.mark.parametrize("palette", [AMBER, SIX, MONO])
def test_powers_and_directions_are_refined_by_color(
    make_table: MakeTable, palette: Palette
) -> None:
    limits = replace(unlimited(6, palette, off=True), continuous_power=True)
    scorer = scorer_of(make_table, limits, lam=10.0)
    start = scorer.design(scorer.at_node(1), np.arange(6) % len(palette.names))
    found = alternating_search(scorer, start, max_rounds=1)
    assert found.score >= scorer.score(start.phi, start.power)
    assert found.score == pytest.approx(scorer.score(found.design.phi, found.design.power))
    assert (np.count_nonzero(found.design.drive, axis=1) <= 1).all()
