"""How much work fits into the time: the pace of renders and what follows from it."""

from __future__ import annotations

import numpy as np
import pytest

from optimize.overnight.context import FIT_STEPS, MIN_SAMPLES, CostModel, FixedBudget
from render.reference.job import RenderJob
from render.reference.transport import transport_jobs
from render.scene.schema import Scene

PHI, BENDS = np.array([np.pi / 2]), np.array([0.0, 0.5])


def jobs_of(scene: Scene, samples: int) -> list[RenderJob]:
    return transport_jobs(scene, PHI, BENDS, samples=samples, seeds=[0])


def seconds_of(jobs: list[RenderJob], fixed: float, each: float) -> list[float]:
    return [fixed + each * job.samples for job in jobs]


def test_the_pace_is_found_from_small_and_large_jobs(finger20: Scene) -> None:
    jobs = jobs_of(finger20, 8) + jobs_of(finger20, 200)
    pace = CostModel.of(jobs, seconds_of(jobs, 0.7, 2e-5), 1)
    assert pace.fixed == pytest.approx(0.7)
    assert pace.each == pytest.approx(2e-5)


@pytest.mark.parametrize("seconds", [30.0, 300.0, 3000.0])
def test_samples_fill_the_seconds_that_they_are_asked_for(finger20: Scene, seconds: float) -> None:
    pace = CostModel(0.7, 2e-5, 1)
    chosen = pace.samples(jobs_of(finger20, 64), 64, seconds)
    assert pace.seconds(jobs_of(finger20, chosen)) == pytest.approx(seconds, rel=0.1)


def test_workers_share_the_jobs_but_no_job_is_split(finger20: Scene) -> None:
    jobs = jobs_of(finger20, 500)
    alone, two, many = (CostModel(0.5, 2e-5, workers).seconds(jobs) for workers in (1, 2, 64))
    longest = max(seconds_of(jobs, 0.5, 2e-5))
    assert alone == pytest.approx(sum(seconds_of(jobs, 0.5, 2e-5)))
    assert alone / 2 <= two <= alone / 2 + longest
    assert many == pytest.approx(longest)


def test_without_time_the_least_is_rendered(finger20: Scene) -> None:
    pace = CostModel(1.0, 1e-3, 1)
    assert pace.samples(jobs_of(finger20, 64), 64, -5.0) == MIN_SAMPLES


def test_a_fixed_amount_of_work_grows_with_what_is_asked_for() -> None:
    small, large = FixedBudget(8), FixedBudget(12_000)
    assert (small.passes, small.per_pass, small.fit_steps) == (1, 8, FIT_STEPS[0])
    assert large.passes * large.per_pass >= 12_000
    assert large.fit_steps == FIT_STEPS[1]
    for name in ("passes", "per_pass", "round", "final", "fit_steps"):
        assert getattr(small, name) <= getattr(large, name)
