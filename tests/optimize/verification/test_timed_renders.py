"""A loop within a time: rounds and finalists share it, whatever searches take."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from optimize.design import baseline_design
from optimize.verification import timed_renders
from optimize.verification.design_renders import DesignRenders
from optimize.verification.finalists import FINALISTS
from optimize.verification.timed_renders import TimedRenders
from render.progress import OnProgress, Progress
from render.reference import TimeBudget
from render.scene import Scene


@dataclass
class Machine:
    """Pretends to render until its share is over, a little early or late."""

    error: float = 0.0
    now: float = 10.0
    took: list[float] = field(default_factory=list)

    def render_within(
        self,
        jobs: Any,
        budget: TimeBudget,
        folder: Path,
        *,
        reserve: Callable[[], float],
        progress: OnProgress,
    ) -> int:
        seconds = max(budget.left() - reserve() + self.error, 1.0)
        progress(Progress(1, 2, note=f"{budget.seconds / 60:g} minutes are too few"))
        self.took.append(seconds)
        self.now += seconds
        return 3


def played(
    scene: Scene,
    machine: Machine,
    folder: Path,
    patch: pytest.MonkeyPatch,
    *,
    rounds: int,
    progress: OnProgress | None = None,
) -> float:
    """Return the seconds of a loop of ``rounds`` out of four with searches of 5 s."""
    base = baseline_design(scene)
    patch.setattr(timed_renders, "render_within", machine.render_within)

    def nothing(designs: Any, **_: Any) -> DesignRenders:
        return DesignRenders(tuple(designs), base.phi, base.phi, base.phi, 0.0)

    patch.setattr(timed_renders, "reference_renders", lambda *_, **__: nothing)
    budget = TimeBudget(180.0, machine.now, lambda: machine.now)
    render = TimedRenders(scene, budget, rounds=4, checkpoint=folder, progress=progress)
    for number in range(rounds):
        machine.now += 5.0
        render([base], samples=0, seeds=[number], title=f"round {number + 1}")
    render([base], samples=0, seeds=[99], title=FINALISTS)
    return budget.spent()


@pytest.mark.parametrize("error", [-2.0, 0.0, 2.0])
@pytest.mark.parametrize("rounds", [4, 1])
def test_the_loop_takes_its_time_even_where_it_ends_early(
    finger20: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: float, rounds: int
) -> None:
    machine = Machine(error)
    spent = played(finger20, machine, tmp_path, monkeypatch, rounds=rounds)
    assert spent == pytest.approx(180.0 - 5.0 - 9.0, abs=abs(error) + 0.1)
    if rounds == 4 and not error:
        *loop, final = machine.took
        assert final == pytest.approx(2 * loop[0], rel=0.1)
        assert max(loop) < 1.1 * min(loop)


def test_that_the_time_is_too_short_is_said_once_and_of_all_of_it(
    finger20: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[Progress] = []
    played(finger20, Machine(), tmp_path, monkeypatch, rounds=2, progress=told.append)
    assert [at.note for at in told] == ["3 minutes are too few", "", ""]
    assert [at.stage for at in told] == ["round 1", "round 2", FINALISTS]


def test_the_same_request_renders_nothing_again(
    finger20: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    machine = Machine()
    played(finger20, machine, tmp_path, monkeypatch, rounds=2)
    calls = len(machine.took)
    played(finger20, machine, tmp_path, monkeypatch, rounds=2)
    assert len(machine.took) == calls == 3
