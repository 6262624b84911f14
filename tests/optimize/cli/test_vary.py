"""``tactilux explore --vary`` from the command line: table, refusals, and a kill in the middle."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from render.scene import load_scene, rewritten, save_scene

ROOT = Path(__file__).parents[3]
Run = Callable[..., Any]


@pytest.fixture(scope="module")
def small_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write the scene file of a DIGIT with four sites."""
    scene = load_scene("digit").with_(sites={"columns": 2, "rows": 2}, indenter={"faces": 6})
    path = tmp_path_factory.mktemp("scene") / "small.toml"
    save_scene(path, rewritten(scene, "", name="small"))
    return path


def test_it_prints_a_table_a_sentence_and_where_the_files_are(
    tactilux: Run, small_file: Path
) -> None:
    said = tactilux("explore", small_file, "--vary", "camera.distance=14.9", "--coarse")
    assert said.code == 0, said.err
    assert "as it is" in said.out
    assert "camera.distance, mm" in said.out
    assert "14.9 mm instead of 15 mm: sensor reader" in said.out
    assert "Report: runs/small-camera-distance/dimensions.html\n" in said.out
    # Nothing is certain, so that the sensor is handed over as it is.
    folder = Path("runs/small-camera-distance")
    assert load_scene(folder / "best.toml").hash == load_scene(small_file).hash
    again = tactilux("explore", small_file, "--vary", "camera.distance=14.9", "--coarse", "--json")
    result = json.loads(again.out)
    assert [row["values"] for row in result["rows"]] == [[14.9], [15.0]]
    assert result["finalists"] == []
    assert "with its best lights" not in again.err


@pytest.mark.parametrize(
    ("more", "told"),
    [
        (["--vary", "pad.thickness=1,2,5"], "pad.thickness = 1, 2 mm makes no valid sensor"),
        (["--vary", "pad.thicknes=5"], "did you mean pad.thickness?"),
        (["--vary", "pad.thickness=5", "--objective", "score"], "allowed: sensor, place"),
        (["--vary", "pad.thickness=5", "--robust", "spread"], "--robust does not go with --vary"),
        (["--vary", "pad.thickness=5", "--model", "x"], "--model does not go with --vary"),
        (["--vary", "search.lamps=2", "--lamps", "2"], "allowed: one of both"),
        (["--vary", "pad.thickness=5", "--place", "--lamps", "99"], "lamps = 99, allowed: 1 to 34"),
        (["--vary", "search.runs=0"], "search.runs = 0 makes no valid sensor"),
        (["--lamps-follow"], "lamps follow pad.thickness, which is not varied"),
    ],
)
def test_what_does_not_fit_is_refused_before_anything_is_written(
    tactilux: Run, small_file: Path, more: list[str], told: str
) -> None:
    said = tactilux("explore", small_file, *more)
    assert said.code == 2
    assert told in " ".join(said.err.split())
    assert not Path("runs").exists()


def test_lamps_of_each_number_are_placed_and_each_row_is_a_design(
    tactilux: Run, small_file: Path
) -> None:
    text = small_file.read_text()
    places = '\n[search]\n[[search.places]]\nedge = "left"\n'
    at = 'at = { value = [-6.0, 6.0], unit = "mm", source = "test" }\n'
    Path("sides.toml").write_text(text + places + at)
    said = tactilux("explore", "sides.toml", "--vary", "search.lamps=2,3", "--coarse")
    assert said.code == 0, said.err
    assert "Pareto" in said.out
    assert "2 lamps instead of 3 lamps: sensor reader" in said.out
    design = Path("runs/small-search-lamps/points/2/design.json")
    built = tactilux("build", design, "--out", "mine.toml")
    assert built.code == 0, built.err
    assert load_scene("mine.toml").lamp_count == 2


def test_a_folder_of_something_else_is_left_alone(tactilux: Run, small_file: Path) -> None:
    Path("mine").mkdir()
    Path("mine/notes.txt").write_text("keep me")
    said = tactilux("explore", small_file, "--vary", "camera.distance=14.9", "--out", "mine")
    assert said.code == 2
    assert "left alone" in " ".join(said.err.split())


@pytest.mark.slow
def test_a_killed_study_goes_on_and_finds_the_same_bit_by_bit(
    small_file: Path, tmp_path: Path
) -> None:
    command = [sys.executable, "-m", "optimize.cli", "explore", str(small_file), "--coarse"]
    command += ["--vary", "camera.distance=14.8:15.2:0.1", "--json", "--out"]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    answers = tmp_path / "killed" / "answers"
    with subprocess.Popen(
        [*command, "killed"], cwd=tmp_path, env=environment, stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    ) as process:  # fmt: skip
        deadline = time.monotonic() + 120.0
        while len(list(answers.glob("*.json"))) < 2 and time.monotonic() < deadline:
            time.sleep(0.05)
        process.send_signal(signal.SIGKILL)
    kept = {path.name: path.read_bytes() for path in answers.glob("*.json")}
    assert 2 <= len(kept) < 5
    results = []
    for name in ("killed", "whole"):
        done = subprocess.run(
            [*command, name], cwd=tmp_path, env=environment, capture_output=True, check=True
        )
        results.append(json.loads(done.stdout))
    assert {path.name: path.read_bytes() for path in answers.glob("*.json")}.items() >= kept.items()
    for key in ("rows", "sentence", "best"):
        first, again = (json.dumps(without_seconds(one[key])) for one in results)
        assert first == again


def without_seconds(part: Any) -> Any:
    if isinstance(part, dict):
        return {name: without_seconds(one) for name, one in part.items() if name != "seconds"}
    return [without_seconds(one) for one in part] if isinstance(part, list) else part
