"""Tolerances in degrees: built sensors read as readers read them, with exact slopes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from optimize.design import Design, dimmed_baseline, limits_of
from optimize.objectives import READERS, ReaderName
from optimize.readers import CameraModel, merit_of
from optimize.robust.perturbed_sensors import PerturbedSensors, RobustObjective, rate_robustly
from optimize.robust.sensitivity import exact_slopes, sensitivities
from optimize.scoring import TableScorer, search_table
from optimize.search import ReaderObjective
from render.scene import Scene, Spread
from surrogate.runtime import Checker
from tests.optimize.slopes import assert_slopes_are_differences

SPREADS = {
    "led_power": Spread("normal", 0.1, "x"),
    "fiber_angle": Spread("normal", 0.1, "x"),
    "scattering": Spread("normal", 0.1, "x"),
    "camera_gain": Spread("normal", 0.1, "x"),
}


@pytest.fixture(scope="module")
def scorer(finger20: Scene, finger20_checker: Checker) -> TableScorer:
    return TableScorer(search_table(finger20_checker), limits=limits_of(finger20))


@pytest.fixture(scope="module")
def slopes(scorer: TableScorer) -> dict[str, np.ndarray]:
    """Return invented slopes of a material by facet, and of the untouched pad."""
    return {
        "scattering": 0.3 * np.random.default_rng(5).standard_normal(scorer.table.with_pad.shape)
    }


@pytest.fixture
def design(finger20: Scene) -> Design:
    base = dimmed_baseline(finger20)
    turned = base.phi + np.random.default_rng(5).normal(0, 0.1, 20)
    return Design(turned, 0.7 * base.drive, base.palette)


@pytest.mark.parametrize("reader", READERS)
def test_a_sensor_without_errors_reads_as_the_search_says(
    scorer: TableScorer, finger20: Scene, design: Design, reader: ReaderName
) -> None:
    goal = ReaderObjective(scorer, finger20, reader, CameraModel.of(finger20))
    sensors = PerturbedSensors(merit_of(reader, scorer, finger20), {}, {}, draws=2, seed=0)
    assert sensors.values(design) == pytest.approx(goal.value(design), rel=1e-9)
    rating = rate_robustly(sensors, design)
    assert rating.nominal == pytest.approx(rating.tenth)
    assert rating.nominal == pytest.approx(-goal.value(design), rel=1e-9)  # told as degrees


@pytest.mark.parametrize("reader", READERS)
def test_slopes_over_built_sensors_are_those_of_differences(
    scorer: TableScorer,
    finger20: Scene,
    slopes: dict[str, np.ndarray],
    design: Design,
    reader: ReaderName,
) -> None:
    sensors = PerturbedSensors(merit_of(reader, scorer, finger20), SPREADS, slopes, draws=3, seed=1)
    goal = RobustObjective(sensors, "spread")
    assert_slopes_are_differences(goal, design, np.random.default_rng(5))


def test_a_gain_of_the_camera_costs_no_degrees_for_exposure_is_a_designs_own(
    scorer: TableScorer, finger20: Scene, slopes: dict[str, np.ndarray], design: Design
) -> None:
    sensor = merit_of("sensor", scorer, finger20)
    found = {one.name: one for one in sensitivities(sensor, design, SPREADS, slopes, draws=20)}
    assert abs(found["camera_gain"].low_loss) < 1e-3
    assert found["led_power"].low_loss > 0.01
    exact = exact_slopes(sensor, design, list(SPREADS), slopes)
    assert abs(exact["camera_gain"][0]) < 1e-6
    # What is told is degrees: where they rise, the merit falls.
    np.testing.assert_allclose(found["led_power"].slope, -exact["led_power"])


def test_one_built_sensor_in_ten_is_worse_than_what_is_told(
    scorer: TableScorer, finger20: Scene, slopes: dict[str, np.ndarray], design: Design
) -> None:
    sensors = PerturbedSensors(
        merit_of("sensor", scorer, finger20), SPREADS, slopes, draws=60, seed=2
    )
    rating, degrees = rate_robustly(sensors, design), -sensors.values(design)
    assert (degrees > rating.tenth).mean() == pytest.approx(0.1, abs=0.02)
    assert rating.tenth_interval[0] <= rating.tenth <= rating.tenth_interval[1]
    assert rating.better(replace(rating, tenth=rating.tenth + 0.1))
