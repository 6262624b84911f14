"""Parts of scene files: their own, those that a search names, and what is refused."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from render.errors import SceneError
from render.scene import Scene, entries_of, known_entries, load_scene, responses, scene_text
from render.scene.catalog.led import shipped_leds

MINE = """
[[parts]]
name = "mine"
source = "a data sheet"
body_mm = [1.6, 0.8]
half_angle_deg = 60
dies = [{ nm = 465, mcd = 100, ma = 20 }]
"""


def scene_with(tmp_path: Path, text: str, name: str = "digit") -> Scene:
    (tmp_path / "mine.toml").write_text(scene_text(name) + text)
    return load_scene(tmp_path / "mine.toml")


def test_a_part_of_five_lines_is_known_beside_the_shipped_ones(tmp_path: Path) -> None:
    scene = scene_with(tmp_path, MINE + '[search]\nparts = ["mine", "red-0603"]\n')
    own = known_entries(scene.parts or ())["mine"]
    assert own.led.diameter == pytest.approx(math.sqrt(4 / math.pi * 1.6 * 0.8), abs=1e-3)
    assert own.led.exponent == 1.0
    assert scene.hash == load_scene("digit").hash


def test_an_own_part_takes_the_place_of_a_shipped_one_of_its_name(tmp_path: Path) -> None:
    scene = scene_with(tmp_path, MINE.replace('"mine"', '"red-0603"'))
    assert known_entries(scene.parts or ())["red-0603"].die.nm == 465.0


def test_names_of_entries_are_all_different() -> None:
    names = [entry.name for led in shipped_leds().values() for entry in entries_of(led)]
    assert len(set(names)) == len(names)
    assert len(shipped_leds()) >= 20


def test_responses_keep_ratios_of_power_and_are_at_most_one() -> None:
    half, full = (
        entries_of(shipped_leds()["red-0603"].model_copy(update={"dies": (die,)}))[0]
        for die in (
            shipped_leds()["red-0603"].dies[0].model_copy(update={"mcd": 125.0}),
            shipped_leds()["red-0603"].dies[0],
        )
    )
    seen = responses([half, full], ("red", "green", "blue"))
    assert seen.max() == 1.0
    assert np.allclose(seen[0], seen[1] / 2)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            '[search]\nparts = ["red-0604"]\n',
            "= red-0604, allowed: .*did you mean red-0603",
        ),
        ('[search]\nparts = ["red-0603", "red-0603"]\n', "names red-0603 twice, allowed: once"),
        ('[search]\nparts = ["infrared-0603"]\n', "no channel of the camera sees infrared-0603"),
        (
            '[search]\nprice = { value = 1.0, unit = "USD", source = "x" }\n',
            "search.price without search.parts, allowed: parts",
        ),
        (MINE + MINE, "parts name mine twice, allowed: once"),
        (MINE.replace("mcd = 100,", ""), r"parts.0.dies.0 names no power, allowed: mcd, lm"),
        (MINE.replace("mcd = 100", "mcd = 100, lm = 1"), "names mcd and lm, allowed: mcd"),
        (MINE.replace("nm = 465,", ""), "allowed: nm or response, one of them"),
        (MINE.replace("nm = 465,", "response = [1, 0, 0],"), "allowed: mw or mw_per_sr"),
        (MINE.replace("ma = 20", "ma = 20, max_ma = 5"), "allowed: at most its max_ma = 5"),
        (MINE.replace("60", "90"), "half_angle_deg = 90: allowed: 1 to 85"),
        (MINE.replace("[1.6, 0.8]", "[1.6]"), "parts.0.body_mm"),
        (MINE.replace('"mine"', '"Mine"'), "parts.0.name = .*allowed: 1 to 32 of a-z"),
        (
            MINE.replace("nm = 465, mcd = 100", "response = [1, 0], mw = 1")
            + '[search]\nparts = ["mine"]\n',
            "mine has a response of 2 values, allowed: 3, one per channel",
        ),
        (
            MINE.replace("}]", "}, { nm = 600, mcd = 1, ma = 1 }]"),
            "several, allowed: a name for each",
        ),
        (
            MINE.replace("{ nm", '{ name = "blue", nm')
            .replace('"mine"', '"' + "m" * 30 + '"')
            .replace("}]", '}, { name = "red", nm = 600, mcd = 1, ma = 1 }]'),
            "is too long a name, allowed: 32 letters",
        ),
    ],
)
def test_what_is_refused_is_told_in_a_sentence(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(SceneError, match=said):
        scene_with(tmp_path, text)


def test_channels_without_a_known_response_are_told(tmp_path: Path) -> None:
    text = scene_text("digit").replace(
        "columns = 240", 'columns = 240\nchannels = ["cyan", "green", "blue"]'
    )
    (tmp_path / "mine.toml").write_text(text + '[search]\nparts = ["red-0603"]\n')
    with pytest.raises(SceneError, match=r"what the channel cyan sees of red-0603 is not known"):
        load_scene(tmp_path / "mine.toml")
