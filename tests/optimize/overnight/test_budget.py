"""How much work fits into the time, and what a fixed amount of work is."""

from __future__ import annotations

import numpy as np
import pytest

from optimize.overnight.context import FIT_STEPS, MIN_SAMPLES, fixed_amounts, samples_within
from render.reference import RenderCost, RenderJob, transport_jobs
from render.scene import Scene


def jobs_of(scene: Scene, samples: int) -> list[RenderJob]:
    phi, bends = np.array([np.pi / 2]), np.array([0.0, 0.5])
    return transport_jobs(scene, phi, bends, samples=samples, seeds=[0])


@pytest.mark.parametrize("seconds", [30.0, 300.0, 3000.0])
def test_samples_fill_the_seconds_that_they_are_asked_for(finger20: Scene, seconds: float) -> None:
    cost = RenderCost(0.7, 2e-5)
    chosen = samples_within(cost, jobs_of(finger20, 64), seconds)
    assert cost.seconds(jobs_of(finger20, chosen)) == pytest.approx(seconds, rel=0.1)


def test_without_time_the_least_is_rendered(finger20: Scene) -> None:
    assert samples_within(RenderCost(1.0, 1e-3), jobs_of(finger20, 64), -5.0) == MIN_SAMPLES


def test_a_fixed_amount_of_work_grows_with_what_is_asked_for() -> None:
    small, large = fixed_amounts(8), fixed_amounts(12_000)
    assert small["table"] == {"passes": 1, "samples": 8}
    assert small["fit"]["steps"] == FIT_STEPS[0]
    assert large["table"]["passes"] * large["table"]["samples"] >= 12_000
    assert large["fit"]["steps"] == FIT_STEPS[1]
    for stage, amounts in small.items():
        for name, amount in amounts.items():
            assert amount <= large[stage][name]
