"""What renders cost, and what a budget of minutes buys."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import pytest

from render.progress import Progress
from render.reference import RenderCost, RenderJob, cost, stored_plan, transport_jobs
from render.scene import load_scene


def test_the_cost_of_a_sample_is_the_slope_between_two_renders_and_the_rest(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock, rendered = [0.0], []
    real = cost.render_transport

    def counted(*args: object, samples: int, **rest: object) -> object:
        # Real renders of a known duration: 3 s and 0.5 s per sample of every cell.
        steps: list[Progress] = []
        found = real(*args, samples=samples, progress=steps.append, **rest)  # type: ignore[arg-type]
        rendered.append(steps[-1].total)
        clock[0] += 3.0 + 0.5 * samples
        return found

    monkeypatch.setattr(cost, "TRIALS", (2, 6))
    monkeypatch.setattr(cost, "render_transport", counted)
    monkeypatch.setattr("render.reference.cost.time.monotonic", lambda: clock[0])
    found = cost.measure_render_cost(load_scene("finger20"), np.array([1.0]))
    assert (found.fixed, found.per_sample, found.trials) == pytest.approx((3.0, 0.5, 10.0))
    assert rendered[1] == pytest.approx(3 * rendered[0], rel=0.1)


def test_samples_fill_the_seconds_that_trials_and_beginnings_leave() -> None:
    known = cost.RenderCost(fixed=3.0, per_sample=0.5, trials=10.0)
    assert known.samples_within(10.0 + 2 * (3.0 + 0.5 * 8), [1.0, 1.0]) == 8
    assert known.samples_within(10.0 + 2 * 3.0 + 0.5 * (8 + 2), [1.0, 0.25]) == 8
    assert known.samples_within(1.0, [1.0], at_least=4) == 4


def jobs_of(samples: int) -> list[RenderJob]:
    phi, bends = np.array([np.pi / 2]), np.array([0.0, 0.5])
    return transport_jobs(load_scene("finger20"), phi, bends, samples=samples, seeds=[0])


def seconds_of(jobs: list[RenderJob], fixed: float, each: float) -> list[float]:
    return [fixed + each * job.samples for job in jobs]


def test_the_cost_is_found_from_small_and_large_jobs() -> None:
    trials = jobs_of(8), jobs_of(200)
    found = RenderCost.fitted(
        [sum(job.samples for job in jobs) for jobs in trials],
        [sum(seconds_of(jobs, 0.7, 2e-5)) for jobs in trials],
        jobs=len(trials[0]),
    )
    assert (found.fixed, found.per_sample) == pytest.approx((0.7, 2e-5))


def test_workers_share_the_jobs_but_no_job_is_split() -> None:
    jobs = jobs_of(500)
    alone, two, many = (RenderCost(0.5, 2e-5, workers).seconds(jobs) for workers in (1, 2, 64))
    longest = max(seconds_of(jobs, 0.5, 2e-5))
    assert alone == pytest.approx(sum(seconds_of(jobs, 0.5, 2e-5)))
    assert alone / 2 <= two <= alone / 2 + longest
    assert many == pytest.approx(longest)


@dataclass(frozen=True)
class Portion:
    minutes: float
    samples: int


def test_a_stored_plan_is_taken_up_where_it_answers_the_same_request(tmp_path: Path) -> None:
    path = tmp_path / "plan.json"

    def planned(minutes: float, samples: int) -> Portion:
        return stored_plan(path, Portion, {"minutes": minutes}, lambda: Portion(minutes, samples))

    assert planned(3.0, 40) == planned(3.0, 50) == Portion(3.0, 40)
    assert planned(4.0, 60) == Portion(4.0, 60)
    for damaged in ("", "{", "[1]", '{"minutes": 4.0}', '{"other": 1}'):
        path.write_text(damaged)
        assert planned(4.0, 70) == Portion(4.0, 70)
        assert json.loads(path.read_text()) == asdict(Portion(4.0, 70))
