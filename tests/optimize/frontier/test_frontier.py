"""What a frontier renders, and where it goes on."""

from __future__ import annotations

from pathlib import Path

import pytest

from optimize.frontier.frontier import PLAN, FrontierPlan, make_frontier_plan
from optimize.frontier.held_out import HeldOutDesigns
from optimize.ui.output import OutputError, check_target
from render.scene import Scene
from tests.disk import DURABLE, logged_disk


def plan(scene: Scene, folder: Path, count: int = 3, **request: int) -> FrontierPlan:
    wanted = {"seed": 0, "minutes": 30.0, "samples": 320} | request
    return make_frontier_plan(
        HeldOutDesigns.of(scene, count, 0),
        folder,
        renders_table=False,
        **wanted,  # type: ignore[arg-type]
    )


def test_given_samples_fix_all_other_work(
    finger20: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = logged_disk(monkeypatch)
    made = plan(finger20, tmp_path)
    assert (made.samples, made.short, made.spp) == (320, [10, 40], [4, 16])
    assert calls == DURABLE


def test_the_same_request_takes_the_stored_plan_up(finger20: Scene, tmp_path: Path) -> None:
    first = plan(finger20, tmp_path)
    stored = (tmp_path / PLAN).read_text().replace("[4, 16]", "[2, 8]")
    (tmp_path / PLAN).write_text(stored)
    assert plan(finger20, tmp_path).spp == [2, 8]
    assert plan(finger20, tmp_path, count=4).spp == first.spp


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
