"""Tolerances: draws, robust ratings and slopes that finite differences confirm."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from optimize.design import Design
from optimize.robust.material_slopes import neighbors
from optimize.robust.perturbed_sensors import PerturbedSensors, RobustObjective, rate_robustly
from optimize.robust.sensitivity import exact_slopes, sensitivities
from optimize.scoring import ScoreMerit, TableScorer
from optimize.search import multi_start
from render.scene import Scene, Spread
from render.transport import TransportTable

MakeTable = Callable[..., TransportTable]
FIBERS = 6
SPREADS = {
    "led_power": Spread("normal", 0.1, "x"),
    "fiber_angle": Spread("uniform", 0.1, "x"),
    "scattering": Spread("normal", 0.1, "x"),
    "sigma_v": Spread("normal", 0.1, "x"),
    "camera_gain": Spread("normal", 0.05, "x"),
}


@pytest.fixture
def scorer(make_table: MakeTable) -> TableScorer:
    return TableScorer(make_table(FIBERS, 7, 2, 3, 5))


@pytest.fixture
def slopes(scorer: TableScorer) -> dict[str, np.ndarray]:
    """Return invented slopes of two materials: smooth in phi, different in every cell."""
    rng, shape = np.random.default_rng(5), scorer.table.T.shape
    cell = rng.standard_normal((shape[0], 1, *shape[2:]))
    wave = np.cos(scorer.table.phi)[:, None, None, None]
    return {"scattering": -0.5 + 0.2 * cell * wave, "sigma_v": 0.3 * cell + 0.1 * wave}


@pytest.fixture
def design() -> Design:
    return Design.of_colors(np.linspace(0.7, 2.2, FIBERS), np.arange(FIBERS) % 3)


def test_without_errors_every_sensor_is_the_one_drawn(scorer: TableScorer, design: Design) -> None:
    sensors = PerturbedSensors(ScoreMerit(scorer), {}, {}, draws=3, seed=0)
    assert sensors.values(design) == pytest.approx(scorer.score(design.phi, design.power))


def test_a_built_sensor_is_the_table_with_its_errors(
    scorer: TableScorer, slopes: dict[str, np.ndarray], design: Design
) -> None:
    sensors = PerturbedSensors(ScoreMerit(scorer), SPREADS, slopes, draws=4, seed=3)
    errors = {name: error[2] for name, error in sensors.errors.items()}
    log = sum(
        errors[name][:, None, None, None, None] * slopes.get(name, 1.0)
        for name in SPREADS
        if name != "fiber_angle"
    )
    # The factor is taken at the nodes here and at phi there: equal for a polynomial, nearly else.
    built = TableScorer(replace(scorer.table, T=scorer.table.T * np.exp(log)))
    expected = built.score(design.phi + errors["fiber_angle"], design.power)
    assert sensors.values(design)[2] == pytest.approx(expected, rel=2e-3)


def test_derivatives_of_the_robust_score_equal_finite_differences(
    scorer: TableScorer, slopes: dict[str, np.ndarray], design: Design
) -> None:
    sensors, h = PerturbedSensors(ScoreMerit(scorer), SPREADS, slopes, draws=12, seed=1), 1e-6
    for measure in ("quantile", "spread"):
        goal = RobustObjective(sensors, measure)
        value, slope, _ = goal.gradient(design)
        assert value == pytest.approx(goal.value(design), rel=1e-12)
        for fiber in range(FIBERS):
            step = h * np.eye(FIBERS)[fiber]
            up, down = (goal.value(replace(design, phi=design.phi + s * step)) for s in (1, -1))
            assert slope[fiber] == pytest.approx((up - down) / (2 * h), rel=1e-3, abs=1e-3)
        dimmed = replace(design, drive=0.5 * design.drive)
        step = h * (np.arange(design.drive.size).reshape(design.drive.shape) % 3)
        up, down = (goal.value(replace(dimmed, drive=dimmed.drive + s * step)) for s in (2, 1))
        by_power = goal.gradient(replace(dimmed, drive=dimmed.drive + 1.5 * step))[2]
        assert (by_power * step).sum() == pytest.approx(up - down, rel=1e-3)


def test_refining_raises_the_robust_score_and_keeps_to_full_power(
    scorer: TableScorer, slopes: dict[str, np.ndarray], design: Design
) -> None:
    goal = RobustObjective(
        PerturbedSensors(ScoreMerit(scorer), SPREADS, slopes, draws=12, seed=1), "quantile"
    )
    found = multi_start(scorer, goal, [design])
    best, value = found.design, found.score
    assert value > goal.value(design)
    assert value == pytest.approx(goal.value(best))
    assert np.array_equal(best.power.max(axis=1), np.ones(FIBERS))
    others = PerturbedSensors(ScoreMerit(scorer), SPREADS, slopes, draws=60, seed=9)
    rating = rate_robustly(others, best)
    assert rating.tenth_interval[0] <= rating.tenth <= rating.tenth_interval[1] < rating.nominal


def test_slopes_by_tolerance_equal_finite_differences(
    scorer: TableScorer, slopes: dict[str, np.ndarray], design: Design
) -> None:
    exact, h = exact_slopes(ScoreMerit(scorer), design, list(SPREADS), slopes), 1e-5

    def moved(name: str, error: np.ndarray) -> float:
        if name == "fiber_angle":
            return scorer.score(design.phi + error, design.power)
        sensors = PerturbedSensors(
            ScoreMerit(scorer), {name: SPREADS[name]}, slopes, draws=1, seed=0
        )
        sensors.errors[name] = error[None]
        sensors._factor = error[None] if name not in slopes else np.zeros((1, FIBERS))
        return float(sensors.values(design)[0])

    for name, slope in exact.items():
        for index in range(len(slope)):
            error = np.zeros(len(slope))
            error[index] = h
            quotient = (moved(name, error) - moved(name, -error)) / (2 * h)
            assert slope[index] == pytest.approx(quotient, rel=1e-3, abs=1e-3)


def test_the_dearest_tolerance_comes_first(
    scorer: TableScorer, slopes: dict[str, np.ndarray], design: Design
) -> None:
    small = {name: replace(spread, deviation=1e-3) for name, spread in SPREADS.items()}
    small["camera_gain"] = Spread("normal", 0.2, "x")
    found = sensitivities(ScoreMerit(scorer), design, small, slopes, draws=100)
    assert found[0].name == "camera_gain"
    assert found[0].worst_fiber is None
    losses = [entry.low_loss for entry in found]
    assert losses == sorted(losses, reverse=True)
    power = next(entry for entry in found if entry.name == "led_power")
    assert power.deviation == pytest.approx(power.low_loss / 1.28, rel=0.5)


def test_neighboring_materials_lie_on_both_sides(finger20: Scene) -> None:
    assert finger20.diffuser is not None
    around = neighbors(finger20, "diffuser_thickness")
    low, high = around.below.diffuser, around.above.diffuser
    assert low is not None
    assert high is not None
    assert high.thickness - low.thickness == pytest.approx(2 * around.step)
    assert neighbors(finger20, "sigma_v").above.fibers.sigma_v > finger20.fibers.sigma_v
    assert around.above.hash != finger20.hash
