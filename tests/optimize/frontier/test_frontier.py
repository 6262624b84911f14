"""What a frontier renders, and where it goes on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from optimize.frontier import frontier
from optimize.frontier.frontier import PLAN, FrontierPlan, make_frontier_plan
from optimize.frontier.held_out import HeldOutDesigns
from optimize.ui.output import OutputError, check_target
from render.files import read_json, write_json
from render.progress import OnProgress, Progress
from render.reference import RenderCost, TimeBudget
from render.scene import Scene
from tests.disk import DURABLE, logged_disk


def plan(scene: Scene, folder: Path, count: int = 3) -> FrontierPlan:
    return make_frontier_plan(
        HeldOutDesigns.of(scene, count, 0),
        folder,
        0,
        TimeBudget.of_minutes(30.0),
        320,
        renderers=True,
    )


def test_given_samples_fix_all_other_work(
    finger20: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = logged_disk(monkeypatch)
    made = plan(finger20, tmp_path)
    assert (made.samples, made.short) == (320, [10, 40])
    assert made.per_pass is None
    assert made.small_steps
    assert calls == DURABLE


def test_the_same_request_takes_the_stored_plan_up(finger20: Scene, tmp_path: Path) -> None:
    first = plan(finger20, tmp_path)
    stored = read_json(tmp_path / PLAN)
    assert stored["short"] == [10, 40]
    write_json(tmp_path / PLAN, stored | {"short": [20, 80]})
    assert plan(finger20, tmp_path).short == [20, 80]
    assert plan(finger20, tmp_path, count=4).short == first.short


@dataclass
class Machine:
    """Pretends to render on a clock of its own, ``rate`` samples of every cell per second."""

    rate: float
    compiling: float
    now: float = 100.0
    took: float = 0.0

    def render_within(
        self,
        jobs: Any,
        budget: TimeBudget,
        folder: Path,
        *,
        reserve: Callable[[], float],
        progress: OnProgress,
    ) -> int:
        reserve()
        self.now += self.compiling
        progress(Progress(0, 1))
        self.took = budget.left() - reserve()
        self.now += self.took
        each = jobs[0].chains * jobs[0].iterations
        cells = len(jobs[0].phi) * 15
        return max(1, round(self.took * self.rate / (each / cells)))


@pytest.mark.parametrize("renderers", [True, False])
@pytest.mark.parametrize(("minutes", "compiling"), [(3.0, 0.1), (3.0, 2.0), (30.0, 10.0)])
def test_minutes_hold_the_reference_and_all_that_is_planned_by_it(
    finger20: Scene,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    minutes: float,
    compiling: float,
    renderers: bool,
) -> None:
    machine = Machine(rate=20.0, compiling=compiling)
    monkeypatch.setattr(frontier, "render_within", machine.render_within)
    budget = TimeBudget(60.0 * minutes, machine.now, lambda: machine.now)
    machine.now += 10.0
    designs = HeldOutDesigns.of(finger20, 3, 0)
    made = make_frontier_plan(designs, tmp_path, 0, budget, None, renderers)
    assert made.minutes == minutes
    assert made.per_pass is not None
    assert made.samples % made.per_pass == 0
    assert made.samples == pytest.approx(20.0 * machine.took, rel=0.1)
    assert all(count % made.per_pass == 0 for count in made.short)
    short, longer = made.short[0], made.short[-1]
    others = short + (1 + renderers) * longer
    others += 2.5 * longer * made.small_steps
    # Flat and bent, pressed and untouched; those of small steps take twice as long to compile.
    kernels = (renderers + 2 * made.small_steps) * 4 * compiling
    before = budget.spent() + others / 20.0 + kernels
    # The path tracer gets what is left.
    assert (0.75 if renderers else 0.95) * 60.0 * minutes < before < 1.02 * 60.0 * minutes
    if not renderers:
        assert not made.small_steps
        return
    machine.now = budget.began + before
    monkeypatch.setattr(frontier, "_tracer_cost", lambda _: RenderCost(0.01, 0.005))
    spp = frontier._tracer_samples(designs, made, tmp_path, budget)
    traced = 3 * sum(0.01 + 0.005 * count for count in spp)
    assert before + traced == pytest.approx(60.0 * minutes, rel=0.02)
    machine.now += 50.0
    assert frontier._tracer_samples(designs, made, tmp_path, budget) == spp


@pytest.mark.parametrize("content", ["", "{", "[1]", '{"scene_hash": "x"}', '{"a": 1}'])
def test_a_damaged_plan_is_made_again(finger20: Scene, tmp_path: Path, content: str) -> None:
    (tmp_path / PLAN).write_text(content)
    assert plan(finger20, tmp_path).samples == 320


def test_a_folder_with_other_files_is_left_alone(tmp_path: Path) -> None:
    check_target(tmp_path / "new", PLAN)
    check_target(tmp_path, PLAN)
    (tmp_path / "thesis.txt").write_text("mine")
    with pytest.raises(OutputError, match="holds files but no earlier result"):
        check_target(tmp_path, PLAN)
    with pytest.raises(OutputError, match="is not a directory"):
        check_target(tmp_path / "thesis.txt", PLAN)
    (tmp_path / PLAN).write_text("{}")
    check_target(tmp_path, PLAN)
