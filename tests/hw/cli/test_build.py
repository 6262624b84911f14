"""``explore --place`` finds new places for the same lamps, and ``build`` makes them a sensor."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from optimize.design import baseline_design, load_design
from optimize.exploration import rate
from optimize.scoring import open_model
from optimize.ui.output import MANIFEST
from render.scene import load_scene, scene_text

ROOT = Path(__file__).parents[3]
Run = Callable[..., Any]
RAILS = """
[search]
lamps = 3

[[search.places]]
edge = "left"
pitch = { value = 6.0, unit = "mm", source = "test" }

[[search.places]]
edge = "right"
pitch = { value = 6.0, unit = "mm", source = "test" }
"""


@dataclass(frozen=True)
class Placed:
    """A search on rails: where its result lies, what was printed, and the result."""

    folder: Path
    said: str
    result: dict[str, Any]


@pytest.fixture(scope="module")
def placed(tmp_path_factory: pytest.TempPathFactory) -> Placed:
    place = tmp_path_factory.mktemp("placed")
    text = scene_text("digit").replace("columns = 3\nrows = 4", "columns = 2\nrows = 2")
    (place / "mine.toml").write_text(text + RAILS)
    done = subprocess.run(
        [sys.executable, "-m", "optimize.cli", "explore", "mine.toml", "--coarse"],
        cwd=place,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    folder = place / "runs" / "digit-explore"
    return Placed(folder, done.stdout, json.loads((folder / MANIFEST).read_text()))


def test_the_same_leds_elsewhere_read_better_and_are_a_sensor(
    placed: Placed, tactilux: Run, tmp_path: Path
) -> None:
    before, after = (placed.result[key]["reader_error_deg"] for key in ("baseline", "optimized"))
    assert after < 0.9 * before
    assert "at new places: sensor reader" in placed.said
    # The three of the file, four places on each edge, and finer ones around two of these.
    count = load_scene(placed.folder / "scene.toml").lamp_count
    assert count == 3 + 4 + 4 + 2
    designs = count + count * (count - 1) // 2 + count * (count - 1) * (count - 2) // 6
    assert placed.result["proven_best_of"] == designs
    assert f"best of all {designs} designs" in placed.said
    report = (placed.folder / "report.html").read_text()
    assert "tactilux build" in report
    design = load_design(placed.folder / "design.json", load_scene(placed.folder / "scene.toml"))
    assert sorted(color for color in design.colors if color >= 0) == [0, 1, 2]

    out = tmp_path / "built.toml"
    done = tactilux("build", placed.folder / "design.json", "--out", out, "--json")
    assert done.code == 0, done.err
    built = load_scene(out)
    assert json.loads(done.out) == {
        "scene": "built", "scene_hash": built.hash, "file": str(out), "lamps": 3,
    }  # fmt: skip
    assert built.lamp_count == 3
    again = tactilux("build", placed.folder / "design.json", "--out", out)
    assert again.code == 2
    assert f"{out} is there: name another file with --out" in again.err

    # Its baseline reads as the design did, but for the exposure that the baseline sets.
    checker = open_model(built, None, coarse=True)
    base = rate(checker, built, "baseline", "Baseline", "", baseline_design(built))
    assert base.reader_error == pytest.approx(after, rel=0.05)


@pytest.mark.parametrize("lamps", [0, 35])
def test_more_lamps_than_places_are_refused(lamps: int, tactilux: Run) -> None:
    done = tactilux("explore", "digit", "--place", "--lamps", lamps, "--coarse")
    assert done.code == 2
    assert "--lamps" in done.err
    assert "allowed: " in done.err


@pytest.mark.parametrize(("name", "said"), [("mine.txt", "allowed: .toml"), (".", "directory")])
def test_a_file_that_is_no_scene_is_refused(
    name: str, said: str, placed: Placed, tactilux: Run, tmp_path: Path
) -> None:
    done = tactilux("build", placed.folder / "design.json", "--out", tmp_path / name)
    assert done.code == 2
    assert said in done.err


def test_a_name_that_no_scene_can_have_is_refused(
    placed: Placed, tactilux: Run, tmp_path: Path
) -> None:
    done = tactilux("build", placed.folder / "design.json", "--out", tmp_path / "My Sensor.toml")
    assert done.code == 2
    assert "name = My Sensor, allowed: 1 to 64 of a-z, 0-9" in done.err
    assert not (tmp_path / "My Sensor.toml").exists()
