"""How much work fits into the time, and what a fixed amount of work is."""

from __future__ import annotations

import numpy as np
import pytest

from optimize.overnight.context import FIT_STEPS, MIN_SAMPLES, FixedBudget, samples_within
from render.reference import RenderCost, RenderJob, transport_jobs
from render.scene import Scene


def jobs_of(scene: Scene, samples: int) -> list[RenderJob]:
    phi, bends = np.array([np.pi / 2]), np.array([0.0, 0.5])
    return transport_jobs(scene, phi, bends, samples=samples, seeds=[0])


@pytest.mark.parametrize("seconds", [30.0, 300.0, 3000.0])
def test_samples_fill_the_seconds_that_they_are_asked_for(finger20: Scene, seconds: float) -> None:
    cost = RenderCost(0.7, 2e-5)
    chosen = samples_within(cost, jobs_of(finger20, 64), 64, seconds)
    assert cost.seconds(jobs_of(finger20, chosen)) == pytest.approx(seconds, rel=0.1)


def test_without_time_the_least_is_rendered(finger20: Scene) -> None:
    assert samples_within(RenderCost(1.0, 1e-3), jobs_of(finger20, 64), 64, -5.0) == MIN_SAMPLES


def test_a_fixed_amount_of_work_grows_with_what_is_asked_for() -> None:
    small, large = FixedBudget(8), FixedBudget(12_000)
    assert (small.passes, small.per_pass, small.fit_steps) == (1, 8, FIT_STEPS[0])
    assert large.passes * large.per_pass >= 12_000
    assert large.fit_steps == FIT_STEPS[1]
    for name in ("passes", "per_pass", "round", "final", "fit_steps"):
        assert getattr(small, name) <= getattr(large, name)
