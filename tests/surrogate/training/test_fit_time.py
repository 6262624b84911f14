"""The networks' steps follow the time that renders leave, and are kept."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from render.reference import TimeBudget
from render.scene import load_scene
from surrogate.train import TrainConfig, training_cost
from surrogate.training import fit_time
from surrogate.training.fit_time import MIN_STEPS, FitTime

MEMBERS, BENDS = 5, 5


@dataclass
class Machine:
    """Pretends to fit; ``rest`` are the seconds of ridge and of export."""

    per_step: float
    rest: tuple[float, float]
    now: float = 50.0

    def trial(self, *_: object) -> float:
        self.now += 60 * self.per_step
        return self.per_step

    def fit(self, limit: FitTime, name: str, most: int, members: int, splits: int) -> int:
        steps = limit.steps(name, most, members=members, splits=splits)
        seconds = steps * self.per_step * members / MEMBERS
        self.now += seconds
        limit.took(steps, members, seconds)
        return steps

    def whole_fit(self, limit: FitTime) -> int:
        self.now += self.rest[0]
        steps = self.fit(limit, "networks", 10_000, MEMBERS, 3)
        for number, name in enumerate(("position", "direction", "bend"), start=1):
            self.fit(limit, name, 5_000, 3, 3 - number)
        self.now += self.rest[1]
        return steps


def limit_of(machine: Machine, minutes: float, folder: Path) -> FitTime:
    cost = training_cost(load_scene("finger20"), TrainConfig(), BENDS)
    budget = TimeBudget(60.0 * minutes, machine.now, lambda: machine.now)
    return FitTime(budget, folder / "fit.json", {"minutes": minutes}, cost)


@pytest.mark.parametrize("minutes", [5.0, 15.0, 60.0])
@pytest.mark.parametrize("slower", [1.0, 3.0])
def test_renders_and_fit_together_take_their_time(
    minutes: float, slower: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Seconds as they were once measured, and on a machine that is three times as slow.
    machine = Machine(0.005 * slower, (10.5 * slower, 6.0 * slower))
    monkeypatch.setattr(fit_time, "seconds_per_step", machine.trial)
    limit = limit_of(machine, minutes, tmp_path)
    machine.now += 60.0 * minutes - limit.reserve() - limit.budget.spent()
    steps = machine.whole_fit(limit)
    assert limit.budget.spent() == pytest.approx(60.0 * minutes, rel=0.1)
    assert steps == 10_000 or minutes < 60.0


def test_a_time_that_cannot_be_kept_is_said_before_everything_with_the_least_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    machine = Machine(0.005, (0.0, 0.0))
    monkeypatch.setattr(fit_time, "seconds_per_step", machine.trial)
    assert limit_of(machine, 5.0, tmp_path).warning() == ""
    said = limit_of(machine, 0.3, tmp_path).warning()
    assert said.startswith("0.3 minutes are too few: with the fewest samples this takes some ")
    # Preview, ten renders, ridge, networks and the rest of finger20, in s.
    least = 27.0 + 22.5 + 10.5 + 1.0 + 6.0
    assert 60.0 * float(said.split("some ")[1].split()[0]) == pytest.approx(least, rel=0.1)


def test_a_night_gives_the_networks_what_its_time_affords() -> None:
    cost = training_cost(load_scene("finger20"), TrainConfig(), BENDS)
    steps = cost.affordable(60.0, 0.005, 200)
    assert 0.005 * cost.fit(steps) == pytest.approx(60.0, abs=0.02)
    assert cost.affordable(1.0, 0.005, 200) == 200
    assert cost.affordable(1e6, 0.005, 200) == 10_000


def test_a_machine_that_slows_down_gets_fewer_steps(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    machine = Machine(0.005, (10.5, 6.0))
    monkeypatch.setattr(fit_time, "seconds_per_step", machine.trial)
    limit = limit_of(machine, 5.0, tmp_path)
    machine.now += 300.0 - limit.reserve() - limit.budget.spent()
    machine.now += 50.0
    slow = replace(machine, per_step=0.02)
    before = limit.steps("split a", 5_000, members=3, splits=0)
    limit.took(1000, MEMBERS, 1000 * slow.per_step)
    assert limit.steps("split b", 5_000, members=3, splits=0) < before


def test_steps_are_kept_for_the_same_request_and_never_too_few(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    machine = Machine(0.005, (0.0, 0.0))
    monkeypatch.setattr(fit_time, "seconds_per_step", machine.trial)
    first, late, other = (limit_of(machine, minutes, tmp_path) for minutes in (5.0, 5.0, 6.0))
    for limit in (first, late, other):
        limit.reserve()
    steps = first.steps("networks", 10_000, members=MEMBERS, splits=3)
    assert steps > MIN_STEPS
    machine.now += 1000.0
    assert late.steps("networks", 10_000, members=MEMBERS, splits=3) == steps
    assert other.steps("networks", 10_000, members=MEMBERS, splits=3) == MIN_STEPS
