"""The frontier over many scenes: which ones, where it goes on, and what it says of all."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from optimize.design import ScoreSettings
from optimize.frontier import Frontier, Survey, survey, surveyed_scenes
from optimize.frontier.frontier import FrontierPlan
from optimize.frontier.held_out import FrontierRow, HeldOutDesigns, HeldOutReference, Interval
from optimize.frontier.plot import survey_png
from optimize.frontier.survey import KEPT, SceneFrontier
from render.errors import RenderError, SceneError
from render.scene import Scene, load_scene
from tests.oracles.soft_domes import round_scene_text

NAMES = ["digit", "gelsight-flat"]


def row(rung: str, error: float, seconds: float = 1.0, held: float | None = 0.9) -> FrontierRow:
    return FrontierRow(
        facet_median=error, facet_p95=2 * error, facet_rms=error, facet_rms_true=error,
        score_median=1.0, score_p95=3.0, kendall_tau=0.9, facet_median_true=error, name=rung,
        rung=rung, level="reference", effort=None, seconds_per_design=seconds,
        setup_seconds=10.0, kendall_tau_interval=(0.8, 1.0),
        interval=None if held is None else Interval(held, 2.0),
    )  # fmt: skip


def frontier(scene: Scene, *rows: FrontierRow) -> Frontier:
    designs = HeldOutDesigns.of(scene, 2, 0)
    counts = np.ones((2, 1, 3, 4, 3))
    reference = HeldOutReference(
        designs, ScoreSettings(1.0, 1.0), counts, 0.1 * counts, np.array([1.0, 2.0]),
        np.array([0.1, 0.1]), np.array([0.1, 0.1]), 8, 60.0,
    )  # fmt: skip
    plan = FrontierPlan(scene.hash, 0, 2, 3.0, 64, 32, False, [2, 8])
    noise = row("noise of the reference", 0.01, held=None)
    return Frontier(plan, rows, noise, reference, None, {"checker.onnx": "none was trained"})


class Measurement:
    """Pretends to measure, and counts; ``broken`` scenes cannot be rendered."""

    def __init__(self, broken: str = "", stop_after: int = 99) -> None:
        self.broken, self.stop_after = broken, stop_after
        self.done: list[str] = []

    def __call__(self, scene: Scene, folder: Path) -> Frontier:
        if len(self.done) == self.stop_after:
            raise KeyboardInterrupt
        if scene.name == self.broken:
            raise RenderError("no light found: move a lamp")
        self.done.append(scene.name)
        return frontier(scene, row("preview", 0.02), row("1/8 of the reference", 0.1, 5.0))


def run(folder: Path, measure: Measurement, **asked: Any) -> tuple[Survey, list[tuple[str, int]]]:
    begun: list[tuple[str, int]] = []
    ticks = itertools.count()
    found = survey(
        surveyed_scenes(NAMES),
        folder,
        lambda scene: {"scene_hash": scene.hash, "minutes": 3.0} | asked,
        measure,
        lambda: float(next(ticks)),
        lambda name, after: begun.append((name, after)),
    )
    return found, begun


def test_a_survey_that_was_stopped_measures_only_what_is_missing(tmp_path: Path) -> None:
    first = Measurement(stop_after=1)
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path, first)
    assert first.done == NAMES[:1]
    second = Measurement()
    found, begun = run(tmp_path, second)
    assert second.done == NAMES[1:]
    assert begun == [("gelsight-flat", 0)]
    assert [scene.scene for scene in found.scenes] == NAMES
    whole, _ = run(tmp_path / "unbroken", Measurement())
    assert found == whole


@pytest.mark.parametrize("change", ["asked", "damaged"])
def test_a_scene_is_measured_again_when_something_else_is_asked_or_its_file_is_damaged(
    tmp_path: Path, change: str
) -> None:
    run(tmp_path, Measurement())
    if change == "damaged":
        (tmp_path / "digit" / KEPT).write_text('{"scene": 1}')
    again = Measurement()
    run(tmp_path, again, **({"minutes": 4.0} if change == "asked" else {}))
    assert again.done == (NAMES if change == "asked" else ["digit"])


def test_a_scene_that_cannot_be_measured_says_why_and_the_others_are_measured(
    tmp_path: Path,
) -> None:
    found, _ = run(tmp_path, Measurement(broken="digit"))
    broken, fine = found.scenes
    assert (broken.failed, broken.rows) == ("no light found: move a lamp", [])
    assert fine.rows
    assert {rung.scenes for rung in found.summary()} == {1}
    assert survey_png(found)[:4] == b"\x89PNG"


def test_a_rung_has_the_median_of_its_scenes_and_all_of_their_scores() -> None:
    noise = row("noise", 0.0, held=None)
    scenes = [
        SceneFrontier(str(i), {}, rows, noise, {}, 64, 1.0)
        for i, rows in enumerate(
            [
                [row("preview", 0.01, held=0.8), row("few renders", 0.02, held=None)],
                [row("preview", 0.03, 3.0, held=1.0)],
                [row("preview", 0.09, 2.0, held=0.9)],
            ]
        )
    ]
    preview, few = Survey(tuple(scenes)).summary()
    assert (preview.rung, preview.scenes, few.scenes) == ("preview", 3, 1)
    assert (preview.facet_median, preview.facet_worst) == (0.03, 0.09)
    assert (preview.ready_seconds, preview.seconds_per_design) == (12.0, 2.0)
    assert preview.score_coverage == pytest.approx(0.9)
    assert few.score_coverage is few.half_width is None


def test_scenes_come_by_name_by_file_and_by_folder(tmp_path: Path) -> None:
    text = (Path(__file__).parents[3] / "render" / "scenes" / "digit.toml").read_text()
    for name in ("b", "a"):
        (tmp_path / f"{name}.toml").write_text(text.replace('"digit"', f'"{name}"'))
    assert list(surveyed_scenes([str(tmp_path), "digit"])) == ["a", "b", "digit"]
    assert surveyed_scenes(["digit"])["digit"].hash == load_scene("digit").hash


def test_all_problems_of_scenes_are_told_at_once(tmp_path: Path) -> None:
    (tmp_path / "bad.toml").write_text("schema = 1")
    (tmp_path / "empty").mkdir()
    with pytest.raises(SceneError) as error:
        surveyed_scenes(["digit", str(tmp_path), str(tmp_path / "empty"), "digit", "nowhere"])
    for part in (
        "bad.toml is not a valid scene",
        "empty holds no scene",
        "second scene",
        "nowhere",
    ):
        assert part in str(error.value)


def test_what_noise_hides_is_drawn_at_the_lower_end(tmp_path: Path) -> None:
    scene = SceneFrontier(
        "one",
        {},
        [replace(row("preview", 0.02), facet_median_true=0.0)],
        row("noise", 0.01),
        {},
        64,
        1.0,
    )
    assert survey_png(Survey((scene,)))[:4] == b"\x89PNG"


def test_a_survey_takes_scenes_with_states(tmp_path: Path) -> None:
    path = tmp_path / "soft.toml"
    path.write_text(round_scene_text(60.0))
    found = surveyed_scenes(["digit", str(path)])
    assert [scene.state_axis for scene in found.values()] == [(0.0,), (0.0, 1.0)]
