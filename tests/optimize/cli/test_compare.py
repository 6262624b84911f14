"""``tactilux compare`` reads designs, layouts and runs, of one scene or several."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from optimize.design import Design, baseline_design, save_design
from optimize.overnight.result import OvernightResult
from optimize.scoring import search_table
from optimize.verification import DesignRenders, RenderDesigns
from render.levels import EFFORTS
from render.reference import EVERYTHING, SampleAllocation
from render.scene import Scene, load_scene
from surrogate.runtime import Checker

Run = Callable[..., Any]


@pytest.fixture
def files(small_scene: Path, tmp_path: Path) -> list[Path]:
    """Write a layout, and a run directory with the baseline of the small sensor."""
    scene = load_scene(small_scene)
    layout = tmp_path / "mine.toml"
    layout.write_text(f'scene = "{small_scene}"\ncolors = "rrrbbggg"\nangles_deg = 60\n')
    save_design(tmp_path / "run" / "design.json", baseline_design(scene), scene)
    return [tmp_path / "run", layout]


def test_scores_and_differences_for_people_and_programs(
    tactilux: Run, files: list[Path], small_scene: Path, small_model: Path, tmp_path: Path
) -> None:
    command = ["compare", *files, "--scene", small_scene, "--model", small_model]
    done = tactilux(*command, "--json", "--out", "page.html")
    assert done.code == 0, done.err
    result = json.loads(done.out)
    assert [entry["name"] for entry in result["designs"]] == ["run", "mine"]
    assert result["level"] == "surrogate"
    assert result["effort"] in EFFORTS
    (one,) = result["differences"]
    first, second = (entry["score"] for entry in result["designs"])
    assert one["value"] == pytest.approx(second - first)
    assert one["interval"][0] < one["value"] < one["interval"][1]
    assert (one["recolored"], one["turned_deg"]) == (0, pytest.approx(30.0))
    html = (tmp_path / "page.html").read_text()
    assert not re.search(r"<script|<link|@import|url\(|https?://", html)
    said = tactilux(*command)
    assert said.code == 0, said.err
    assert f"A: {files[0]}/design.json" in said.out
    assert "B - A" in said.out
    assert "cover those of 90% of pairs of random designs" in " ".join(said.out.split())


def test_renders_of_both_with_common_seeds(
    tactilux: Run,
    files: list[Path],
    small_scene: Path,
    small_model: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: dict[str, object] = {}

    def renders(scene: Scene, checkpoint: Path, progress: object) -> RenderDesigns:
        asked["checkpoint"] = checkpoint

        def render(
            designs: Sequence[Design],
            *,
            samples: int,
            seeds: Sequence[int],
            title: str,
            allocation: SampleAllocation = EVERYTHING,
        ) -> DesignRenders:
            assert allocation.untouched  # which readers see
            asked.update(samples=samples, seeds=list(seeds))
            table, rng = search_table(Checker.load(small_model)), np.random.default_rng(1)
            light = np.stack([table.at(design.phi) for design in designs])
            noisy = light * (1.0 + 0.02 * rng.standard_normal((8, *light.shape)))
            return DesignRenders(tuple(designs), noisy, noisy.mean(axis=-1), noisy.std(axis=0), 1.0)

        return render

    monkeypatch.setattr("optimize.verification.reference_renders", renders)
    command = ["compare", *files, "--scene", small_scene, "--model", small_model]
    done = tactilux(*command, "--samples", 4, "--seeds", 2, "--json")
    assert done.code == 0, done.err
    assert asked == {"checkpoint": files[0] / "compare-renders", "samples": 4, "seeds": [1, 2]}
    result = json.loads(done.out)
    assert {(e["level"], e["effort"]) for e in result["designs"]} == {("reference", None)}
    low, high = result["differences"][0]["interval"]
    assert low < result["differences"][0]["value"] < high


def test_a_finished_night_stands_for_its_winner(
    tactilux: Run, run_directory: Path, finished_night: OvernightResult
) -> None:
    design = run_directory / "designs" / "baseline.json"
    done = tactilux("compare", run_directory, design, "--json")
    assert done.code == 0, done.err
    winner, baseline = json.loads(done.out)["designs"]
    assert winner["file"].endswith(f"designs/{finished_night.winner}.json")
    assert winner["score"] > baseline["score"]


def test_designs_of_two_sensors_are_compared_in_degrees_alone(
    tactilux: Run, tmp_path: Path
) -> None:
    for name in ("digit", "gelsight-flat"):
        scene = load_scene(name)
        save_design(tmp_path / f"{name}.json", baseline_design(scene), scene)
    words = "compare", "digit.json", "gelsight-flat.json"
    done = tactilux(*words, "--json", "--out", "page.html")
    assert done.code == 0, done.err
    result = json.loads(done.out)
    assert [one["scene"] for one in result["designs"]] == ["digit", "gelsight-flat"]
    (one,) = result["differences"]
    first, second = (entry["reader_error_deg"] for entry in result["designs"])
    assert one["reader_error_deg"] == pytest.approx(second - first)
    low, high = one["reader_error_interval"]
    # Wider than by the draws alone: two models are off independently.
    assert low < one["reader_error_deg"] < high
    assert one["better"] == 1
    assert [one[key] for key in ("value", "interval", "better_in_score", "turned_deg")] == [
        None
    ] * 4
    html = (tmp_path / "page.html").read_text()
    assert all(load_scene(name).hash in html for name in ("digit", "gelsight-flat"))
    said = tactilux(*words)
    assert "B reads better" in said.out


def test_one_model_or_scene_does_not_serve_designs_of_two(
    tactilux: Run, files: list[Path], small_scene: Path, small_model: Path, tmp_path: Path
) -> None:
    finger20 = load_scene("finger20")
    save_design(tmp_path / "other.json", baseline_design(finger20), finger20)
    for words, said in (
        (["--scene", small_scene], f"allowed: {load_scene(small_scene).hash}"),
        (["--model", small_model], "is of one scene, allowed: no --model with designs of 2 scenes"),
    ):
        done = tactilux("compare", files[1], "other.json", *words)
        assert (done.code, done.out) == (2, "")
        assert said in done.err


def test_what_cannot_be_compared_raises_one_clear_error(
    tactilux: Run, files: list[Path], tmp_path: Path
) -> None:
    (tmp_path / "empty").mkdir()
    for words, said in (
        ([files[1]], "1 design given, allowed: 2 to 26"),
        ([files[1], "empty"], "empty holds no design.json and no finished night"),
        ([files[1], "nowhere.json"], "cannot be read"),
        ([*files, "--out", "page.png"], "allowed: .html, .htm"),
    ):
        done = tactilux("compare", *words)
        assert (done.code, done.out) == (2, ""), said
        assert said in done.err
        assert "Traceback" not in done.err
