"""explore --parts: from a scene to a design of parts, and to the sensor that it is."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from optimize.design import load_design_file
from render.scene import load_scene, scene_text

Run = Callable[..., Any]
CHIPS = "red-0603,green-0603,blue-0603"


def small(tmp_path: Path, text: str = "") -> Path:
    path = tmp_path / "small.toml"
    drawn = scene_text("digit").replace("columns = 3\nrows = 4", "columns = 2\nrows = 2")
    path.write_text(drawn + text)
    return path


@pytest.mark.slow
def test_a_design_of_parts_is_found_within_its_current_and_built(
    tactilux: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    scene = small(
        tmp_path, '[search]\ncurrent = { value = 45.0, unit = "mA", source = "the board" }\n'
    )
    said = tactilux("explore", str(scene), "--parts", CHIPS, "--coarse", "--json")
    assert said.code == 0
    result = json.loads(said.out)
    design = load_design_file(Path(result["design"])).design
    lit = [name for name in design.color_names if name != "off"]
    assert len(lit) == 2  # of 20 mA each
    assert set(lit) <= set(CHIPS.split(","))
    built = tmp_path / "built.toml"
    assert tactilux("build", result["design"], "--out", str(built)).code == 0
    sensor = load_scene(built)
    assert sorted(sensor.baseline_colors()) == sorted(lit)
    assert {lamp.diameter for lamp in sensor.placed_lamps()} == {1.277}


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--parts", "red-0604"), "did you mean red-0603"),
        (("--parts", "red-0603,"), 'parts = "", allowed: red-0201'),
        (("--parts", "ws2812b", "--lamps", "9"), "lamps = 9, allowed: 1 to 3"),
        (("--parts", "infrared-0603"), "no channel of the camera sees infrared-0603"),
    ],
)
def test_parts_that_cannot_be_are_told_in_one_sentence(
    tactilux: Run, tmp_path: Path, words: tuple[str, ...], said: str
) -> None:
    told = tactilux("explore", str(small(tmp_path)), *words)
    assert told.code == 2
    assert said in told.err
    assert len(told.err.strip().splitlines()) == 1


def test_a_current_can_be_varied_as_other_numbers_are(tmp_path: Path) -> None:
    text = '[search]\ncurrent = { value = 45.0, unit = "mA", source = "the board" }\n'
    scene = load_scene(small(tmp_path, text))
    varied = scene.with_(search_current=60.0)
    assert varied.search is not None
    assert varied.search.current == 60.0
    assert varied.hash == scene.hash
