"""What renders cost, and what a budget of minutes buys."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from render.reference import (
    RenderCost,
    RenderJob,
    growing_cost,
    transport_jobs,
    trial_cost,
)
from render.scene import load_scene


@pytest.mark.parametrize("per_path", [1e-7, 1e-5, 1e-3])
def test_trials_grow_until_they_can_be_measured(per_path: float) -> None:
    """On a machine whose clock jitters by 50 ms, of any speed, compiling once for each size."""
    compiled, rendered = set(), []
    jitter = itertools.cycle([0.05, 0.0])

    def render(jobs: list[RenderJob]) -> list[float]:
        seconds = []
        for job in jobs:
            new = (job.indented, job.chains) not in compiled
            compiled.add((job.indented, job.chains))
            seconds.append(0.3 + per_path * job.samples + 5.0 * new + next(jitter))
            rendered.append(seconds[-1])
        return seconds

    found = trial_cost(jobs_of(8), render)
    assert found.per_sample == pytest.approx(per_path, rel=0.15)
    assert found.fixed == pytest.approx(0.3, abs=0.1)
    assert sum(rendered) < 40.0 + 1e5 * per_path


def test_samples_fill_the_seconds_that_beginnings_leave() -> None:
    known = RenderCost(fixed=3.0, per_sample=0.5)
    assert known.samples_within(2 * (3.0 + 0.5 * 8), [1.0, 1.0]) == 8
    assert known.samples_within(2 * 3.0 + 0.5 * (8 + 2), [1.0, 0.25]) == 8
    assert known.samples_within(1.0, [1.0], at_least=4) == 4


def jobs_of(samples: int) -> list[RenderJob]:
    phi, bends = np.array([np.pi / 2]), np.array([0.0, 0.5])
    return transport_jobs(load_scene("finger20"), phi, bends, samples=samples, seeds=[0])


def seconds_of(jobs: list[RenderJob], fixed: float, each: float) -> list[float]:
    return [fixed + each * job.samples for job in jobs]


def test_the_cost_is_found_from_a_small_and_a_large_trial() -> None:
    found = RenderCost.fitted((8, 200), (0.7 + 8 * 2e-5, 0.7 + 200 * 2e-5))
    assert (found.fixed, found.per_sample) == pytest.approx((0.7, 2e-5))


def test_a_slower_first_trial_is_no_reason_to_promise_anything() -> None:
    """The smallest renders may be noise alone: 1 sample in 26 ms, 9 samples in 25 ms."""
    taken: list[int] = []

    def seconds(units: int) -> float:
        taken.append(units)
        return 0.01 + 1e-3 * units + (0.02 if units == 1 else 0.0)

    found = growing_cost(seconds)
    assert found.per_sample == pytest.approx(1e-3, rel=0.05)
    assert max(taken) == 1024


def test_workers_share_the_jobs_but_no_job_is_split() -> None:
    jobs = jobs_of(500)
    alone, two, many = (RenderCost(0.5, 2e-5, workers).seconds(jobs) for workers in (1, 2, 64))
    longest = max(seconds_of(jobs, 0.5, 2e-5))
    assert alone == pytest.approx(sum(seconds_of(jobs, 0.5, 2e-5)))
    assert alone / 2 <= two <= alone / 2 + longest
    assert many == pytest.approx(longest)
