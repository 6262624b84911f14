"""Tables with an axis of channels: scores, derivatives, error bars and tolerances."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from optimize.design import Design
from optimize.robust.perturbed_sensors import PerturbedSensors
from optimize.robust.sensitivity import exact_slopes
from optimize.scoring import ScoreMerit, TableScorer, rendered_score, score_interval
from render.metric import MetricConfig, design_score, image_counts, site_metric, superposed
from render.scene import Spread
from render.transport import TransportTable

MakeTable = Callable[..., TransportTable]
TINTS = np.array([1.0, 0.6, 0.8])


def tinted(table: TransportTable, seed: int = 4) -> TransportTable:
    """Return the table with three channels, each of another light."""
    rng = np.random.default_rng(seed)
    by_channel = TINTS * np.exp(0.3 * rng.standard_normal((*table.T.shape, 3)))
    return replace(table, T=table.T[..., None] * by_channel, se=table.se[..., None] * by_channel)


def alike(table: TransportTable) -> TransportTable:
    """Return the table with three channels of the same light."""
    T, se = (np.repeat(part[..., None], 3, axis=-1) for part in (table.T, table.se))
    return replace(table, T=T, se=se)


def test_light_of_each_channel_adds_up_by_itself() -> None:
    rng = np.random.default_rng(0)
    light, power = rng.random((5, 2, 3, 4, 3)), rng.random((5, 3))
    found = superposed(light, power)
    for channel in range(3):
        alone = superposed(light[..., channel], power[:, channel : channel + 1])[..., 0]
        np.testing.assert_allclose(found[..., channel], alone)
    many = superposed(np.stack([light, 2.0 * light]), np.stack([power, power]))
    np.testing.assert_allclose(many[1], 2.0 * found)


@pytest.mark.parametrize("config", [MetricConfig(), MetricConfig(cyclic=False)])
def test_derivatives_equal_finite_differences(make_table: MakeTable, config: MetricConfig) -> None:
    scorer = TableScorer(tinted(make_table(6, 7, 3, 4, 6)), config)
    rng = np.random.default_rng(3)
    phi, power = rng.uniform(0.3, 2.8, 6), rng.uniform(0.2, 0.9, (6, 3))
    exact, h = ScoreMerit(scorer), 1e-6
    found = exact.gradient(phi, power)
    assert found.value == pytest.approx(scorer.score(phi, power), rel=1e-12)
    for fiber in range(6):
        step = h * np.eye(6)[fiber]
        slope = (scorer.score(phi + step, power) - scorer.score(phi - step, power)) / (2 * h)
        assert found.phi[fiber] == pytest.approx(slope, rel=1e-4, abs=1e-4)
        for channel in range(3):
            move = np.zeros((6, 3))
            move[fiber, channel] = h
            slope = (scorer.score(phi, power + move) - scorer.score(phi, power - move)) / (2 * h)
            assert found.power[fiber, channel] == pytest.approx(slope, rel=1e-4, abs=1e-4)
    trend = rng.standard_normal(found.light.shape)
    light = [exact.light(phi) * np.exp(sign * h * trend) for sign in (1, -1)]
    ends = exact.values(np.stack([exact.superposed(one, power) for one in light]))
    assert (found.light * trend).sum() == pytest.approx((ends[0] - ends[1]) / (2 * h), rel=1e-5)


def test_channels_of_the_same_light_are_none(make_table: MakeTable) -> None:
    table = make_table(error=0.05)
    plain, scorer = TableScorer(table), TableScorer(alike(table))
    rng = np.random.default_rng(1)
    phi, power = rng.uniform(0.2, 2.9, 8), rng.random((8, 3))
    assert scorer.score(phi, power) == pytest.approx(plain.score(phi, power), rel=1e-12)
    # Channels share the noise of their light paths, as they do without an axis of them.
    assert score_interval(scorer, phi, power) == pytest.approx(score_interval(plain, phi, power))
    one, other = (ScoreMerit(each).gradient(phi, power) for each in (plain, scorer))
    np.testing.assert_allclose(one.phi, other.phi, rtol=1e-10)
    np.testing.assert_allclose(one.power, other.power, rtol=1e-10)
    np.testing.assert_allclose(one.light, other.light.sum(axis=-1), rtol=1e-10)


def test_renders_are_scored_as_their_table(make_table: MakeTable) -> None:
    scorer = TableScorer(tinted(make_table()))
    rng = np.random.default_rng(2)
    phi, power = rng.uniform(0.2, 2.9, 8), rng.random((8, 3))
    light = scorer.table.at(phi)
    counts = image_counts(light, power, scorer.table.exposure)
    score = float(design_score(site_metric(counts, scorer.table.lam)).score)
    assert scorer.score(phi, power) == pytest.approx(score, rel=1e-12)
    from optimize.design import ScoreSettings

    settings = ScoreSettings(scorer.table.exposure, scorer.table.lam)
    found = rendered_score(settings, np.stack([light, light, light]), power)
    assert found.score.value == pytest.approx(score, rel=1e-9)


SPREADS = {
    "led_power": Spread("normal", 0.05, "test"),
    "fiber_angle": Spread("normal", 0.02, "test"),
    "scattering": Spread("normal", 0.1, "test"),
}


def test_built_sensors_of_the_same_light_in_all_channels_score_alike(
    make_table: MakeTable,
) -> None:
    table = make_table(lam=50.0)
    slope = 0.2 * np.random.default_rng(5).standard_normal(table.T.shape)
    design = Design.of_colors(np.full(8, 1.2), [0, 1, 2, 0, 1, 2, 0, 1])
    plain, colored = (
        PerturbedSensors(
            ScoreMerit(TableScorer(each)), SPREADS, {"scattering": by_light}, draws=5, seed=1
        )
        for each, by_light in ((table, slope), (alike(table), np.repeat(slope[..., None], 3, -1)))
    )
    np.testing.assert_allclose(plain.values(design), colored.values(design), rtol=1e-10)
    for one, other in zip(plain.gradients(design), colored.gradients(design), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-8)
    names = list(SPREADS)
    first = exact_slopes(plain.merit, design, names, {"scattering": slope})
    second = exact_slopes(
        colored.merit, design, names, {"scattering": np.repeat(slope[..., None], 3, -1)}
    )
    for name in names:
        np.testing.assert_allclose(first[name], second[name], rtol=1e-8)


def test_slopes_of_built_sensors_equal_finite_differences(make_table: MakeTable) -> None:
    scorer = TableScorer(tinted(make_table(lam=50.0)))
    slope = 0.2 * np.random.default_rng(5).standard_normal(scorer.table.T.shape)
    sensors = PerturbedSensors(ScoreMerit(scorer), SPREADS, {"scattering": slope}, draws=3, seed=1)
    colors, phi, h = [0, 1, 2, 0, 1, 2, 0, 1], np.full(8, 1.2), 1e-6
    design = Design.of_colors(phi, colors)
    _, found, by_power = sensors.gradients(design)
    for fiber in (0, 5):
        step = h * np.eye(8)[fiber]
        ends = [sensors.values(Design.of_colors(phi + s * step, colors)) for s in (1, -1)]
        np.testing.assert_allclose(found[:, fiber], (ends[0] - ends[1]) / (2 * h), rtol=1e-3)
    less = replace(design, drive=(1.0 - h) * design.drive)
    change = (sensors.values(design) - sensors.values(less)) / h
    np.testing.assert_allclose((by_power * design.power).sum(axis=(1, 2)), change, rtol=1e-3)
