"""Renders fill the time they are given, on machines that no estimator knows, and lose nothing."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest

from render.files import read_json, read_npz, write_npz
from render.progress import Progress
from render.reference import (
    RenderJob,
    RenderResult,
    TimeBudget,
    render_transport,
    render_within,
    samples_of_full_pass,
    samples_per_pass,
    stored_plan,
    transport_jobs,
)
from render.scene import Scene, load_scene
from tests.optimize.overnight.tiny import tiny_scene


@dataclass
class Machine:
    """Pretends to render: a job takes its time on a clock of its own, and keeps its state.

    Arguments:
        speed: paths per second at a moment in s.
        compiling: seconds of the first pass of every kind of pad in a process.
        loading: seconds before the first pass of a job.
    """

    speed: Callable[[float], float]
    compiling: float = 2.0
    loading: float = 0.1
    now: float = 1000.0
    compiled: set[tuple[bool, bool]] = field(default_factory=set)
    passes: int = 0

    def run(
        self, job: RenderJob, state: Path, tick: Callable[[int], None], *, keep: bool
    ) -> RenderResult:
        assert keep
        began, done, spent = self.now, 0, 0.0
        self.now += self.loading
        if state.exists():
            kept = read_npz(state)
            done, spent = int(kept["done"]), float(kept["seconds"])
            tick(done * job.chains)
        assert done <= job.iterations
        kind = (job.indented, job.bend > 0)
        try:
            while done < job.iterations:
                if kind not in self.compiled:
                    self.now += self.compiling
                    self.compiled.add(kind)
                self.now += (0.05 + job.chains / self.speed(self.now)) * (1 + job.indented)
                done, self.passes = done + 1, self.passes + 1
                tick(job.chains)
        finally:
            seconds = spent + self.now - began
            write_npz(state, {"done": np.array(done), "seconds": np.array(seconds)})
        return RenderResult(np.full(1, float(done)), np.zeros(1), seconds)


def steady(rate: float) -> Callable[[float], float]:
    return lambda now: rate


def busy_later(now: float) -> float:
    """Twice as slow from the tenth second on, and slower and faster by a third all the time."""
    return 30_000.0 / (1 + (now > 1010.0)) * (1 + 0.33 * np.sin(now))


def unit_jobs(scene: Scene, seconds: float, seeds: int = 1) -> list[RenderJob]:
    bends = np.array(scene.bending.angles)
    each = samples_per_pass(scene, seconds, 2 * len(bends) * seeds)
    return transport_jobs(
        scene, np.array([1.0]), bends, samples=each, per_pass=each, seeds=range(seeds)
    )


@pytest.mark.parametrize("minutes", [0.3, 1.5, 10.0, 60.0])
@pytest.mark.parametrize(
    "speed", [steady(20_000.0), steady(2_000_000.0), busy_later], ids=["slow", "fast", "busy"]
)
def test_a_time_is_kept_within_a_tenth_on_machines_that_nobody_timed(
    minutes: float, speed: Callable[[float], float], tmp_path: Path
) -> None:
    machine, seconds = Machine(speed), 60.0 * minutes
    jobs = unit_jobs(load_scene("finger20"), seconds)
    budget = TimeBudget(seconds, machine.now, lambda: machine.now)
    units = render_within(jobs, budget, tmp_path, reserve=lambda: 3.0, run=machine.run)
    assert (budget.spent() + 3.0) / seconds == pytest.approx(1.0, abs=0.1)
    for job in jobs:
        finished = replace(job, iterations=units * job.iterations)
        assert read_npz(tmp_path / f"{finished.name}.npz")["estimate"] == finished.iterations


@pytest.mark.parametrize("minutes", [0.3, 3.0])
def test_a_time_that_is_too_short_is_said_after_the_first_job_with_what_it_takes(
    minutes: float, tmp_path: Path
) -> None:
    machine, seconds = Machine(steady(200_000.0), compiling=6.0), 60.0 * minutes
    jobs, told = unit_jobs(load_scene("finger20"), seconds), []

    def listen(at: Progress) -> None:
        if at.note:
            told.append((machine.now - 1000.0, at.note))

    budget = TimeBudget(seconds, machine.now, lambda: machine.now)
    render_within(
        jobs, budget, tmp_path, reserve=lambda: 3.0, progress=listen, run=machine.run
    )  # fmt: skip
    if minutes > 1.0:
        assert not told
        return
    ((when, note),) = told
    assert when < 10.0
    assert note.startswith("0.3 minutes are too few: with the fewest samples this takes some ")
    least = 60.0 * float(re.findall(r"[\d.]+", note)[1])
    assert least == pytest.approx(budget.spent() + 3.0, rel=0.3)


@pytest.mark.parametrize(("announced", "said"), [(0.0, 2), (40.0, 1), (60.0, 0)])
def test_jobs_that_load_slowly_are_noticed_when_the_second_of_a_kind_is_done(
    announced: float, said: int, tmp_path: Path
) -> None:
    """A first job that compiles nothing, its kernels being kept, says too little of the others."""
    machine, told = Machine(steady(2_000_000.0), compiling=0.0, loading=5.0), []

    def listen(at: Progress) -> None:
        if at.note:
            told.append((machine.now - 1000.0, at.note))

    jobs = unit_jobs(load_scene("finger20"), 18.0, seeds=2)
    assert len(jobs) == 12
    budget = TimeBudget(18.0, machine.now, lambda: machine.now, announced)
    render_within(jobs, budget, tmp_path, progress=listen, run=machine.run)
    assert len(told) == said
    for when, note in told[-1:]:
        assert when < 0.6 * budget.spent()
        least = 60.0 * float(re.findall(r"[\d.]+", note)[1])
        assert least == pytest.approx(budget.spent(), rel=0.1)


def test_a_reserve_that_turns_out_smaller_is_used_and_a_larger_one_is_kept(tmp_path: Path) -> None:
    jobs, used = unit_jobs(load_scene("finger20"), 60.0), {}
    for name, later in (("smaller", 5.0), ("larger", 30.0)):
        machine, asked = Machine(steady(100_000.0)), []

        def reserve(later: float = later, asked: list[None] = asked) -> float:
            asked.append(None)
            return 15.0 if len(asked) < 3 else later

        budget = TimeBudget(60.0, machine.now, lambda machine=machine: machine.now)
        render_within(jobs, budget, tmp_path / name, reserve=reserve, run=machine.run)
        used[name] = budget.spent() + later
    assert used == pytest.approx({"smaller": 60.0, "larger": 60.0}, abs=6.0)


def test_a_round_that_comes_late_is_given_up_for_the_one_before(tmp_path: Path) -> None:
    machine = Machine(lambda now: 100_000.0 if now < 1040.0 else 200.0)
    jobs = unit_jobs(load_scene("finger20"), 60.0)
    budget = TimeBudget(60.0, machine.now, lambda: machine.now)
    units = render_within(jobs, budget, tmp_path, run=machine.run)
    slow_pass = 2 * jobs[0].chains / 200.0
    assert budget.spent() < 1.05 * 60.0 + slow_pass
    done = [int(read_npz(path)["done"]) for path in tmp_path.glob("*.passes.npz")]
    # What was begun is not lost for a later call.
    assert units >= 1
    assert sum(done) == machine.passes > units * sum(job.iterations for job in jobs)


def test_more_time_adds_to_what_is_there_and_less_renders_nothing(tmp_path: Path) -> None:
    machine, jobs = Machine(steady(100_000.0)), unit_jobs(load_scene("finger20"), 60.0)

    def within(seconds: float) -> int:
        budget = TimeBudget(seconds, machine.now, lambda: machine.now)
        return render_within(jobs, budget, tmp_path, run=machine.run)

    first = within(60.0)
    before, began = machine.passes, machine.now
    assert within(30.0) == first
    assert machine.passes == before
    more = within(120.0)
    assert machine.passes - before == (more - first) * sum(job.iterations for job in jobs)
    # The minute of the first call counts as well.
    assert machine.now - began == pytest.approx(60.0, abs=12.0)


def test_a_pass_is_small_where_many_jobs_share_little_time() -> None:
    scene = load_scene("finger20")
    full = samples_of_full_pass(scene)
    assert full == 54  # 54 * 15 sites * 20 fibers are 16200 paths
    assert [samples_per_pass(scene, s, 48) for s in (-1.0, 18.0, 200.0, 3600.0)] == [3, 3, 13, 54]


def test_passes_of_one_size_are_the_same_paths_however_many_there_are() -> None:
    scene = load_scene("finger20")
    one, nine = (
        transport_jobs(scene, np.array([1.0]), np.zeros(1), samples=n * 13, per_pass=13, seeds=[1])
        for n in (1, 9)
    )
    for short, long in zip(one, nine, strict=True):
        assert replace(short, iterations=9 * short.iterations) == long


class Stop(Exception):
    pass


@pytest.mark.slow
def test_real_renders_end_in_time_and_are_those_of_as_many_samples_to_the_bit(
    tmp_path: Path,
) -> None:
    scene = tiny_scene(tmp_path)
    phi, bends = np.array([np.pi / 2]), np.zeros(1)
    each = 64
    jobs = transport_jobs(scene, phi, bends, samples=each, per_pass=each, seeds=[3])
    told: list[Progress] = []

    def interrupted(at: Progress) -> None:
        told.append(at)
        if len(told) == 2:
            raise Stop

    with pytest.raises(Stop):
        render_within(jobs, TimeBudget.of_minutes(0.1), tmp_path / "kept", progress=interrupted)
    # What the interrupted call took is part of the time.
    units = render_within(jobs, TimeBudget.of_minutes(0.1), tmp_path / "kept")
    assert units >= 1
    assert all(0.0 <= at.done <= at.total == 6.0 for at in told)
    kept, unbroken = (
        render_transport(
            scene, phi, bends, samples=units * each, per_pass=each, seeds=[3], checkpoint=folder,
            runner=None,
        )
        for folder in (tmp_path / "kept", None)
    )  # fmt: skip
    np.testing.assert_array_equal(kept.replicates, unbroken.replicates)
    np.testing.assert_array_equal(kept.background_replicates, unbroken.background_replicates)


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
        assert read_json(path) == asdict(Portion(4.0, 70))
