"""LED colors in scene files: which a scene has, what channels see, limits by name, bad input."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from render.errors import SceneError
from render.scene import RGB, Palette, load_scene
from tests.colored_scenes import COLOR, GREEN, SAID, WHITE, scene_with


def refusal(folder: Path, *args: object, **named: object) -> str:
    with pytest.raises(SceneError) as caught:
        scene_with(folder, *args, **named)  # type: ignore[arg-type]
    return str(caught.value)


def test_what_a_scene_says_of_its_default_leds_leaves_no_trace_in_the_hash(tmp_path: Path) -> None:
    old = load_scene("finger20")
    assert old.palette == RGB
    assert old.hash == "68471ad4c129ea4d"
    said = scene_with(tmp_path, SAID, camera='channels = ["red", "green", "blue"]')
    plain = scene_with(tmp_path, "")
    assert said.hash == plain.hash
    inked = scene_with(tmp_path, WHITE + GREEN, ("white",) * 3)
    other = scene_with(tmp_path, WHITE + 'ink = "#123456"\n' + GREEN, ("white",) * 3)
    assert inked.hash == other.hash != plain.hash
    assert other.palette.ink("white") == "#123456"


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (COLOR.format("white", "[1.0, 1.0]"), "colors.white.response has 2 values, allowed: 3"),
        (COLOR.format("white", "[1.0]"), "colors.white.response has 1 value, allowed: 3"),
        (COLOR.format("white", "[0.0, 0.0, 0.0]"), "is all 0, allowed: some channel must see it"),
        (WHITE + WHITE, "colors name white twice, allowed: once"),
        (
            WHITE + COLOR.format("off", "[1.0, 0.0, 0.0]"),
            "colors.1.name = off: allowed: any other name",
        ),
        (WHITE + COLOR.format("Amber", "[1.0, 0.0, 0.0]"), "colors.1.name = Amber"),
        (COLOR.format("white", "[1.0, 1.2, 0.0]"), "allowed: 0 to 1"),
        (WHITE + "[constraints]\nmax_red = 3", "max_red: the scene has no color red"),
        (WHITE + "[constraints.colors.red]\nmax = 3", "constraints.colors names red"),
        (WHITE + "[constraints.colors.white]\nmax = 3", "at most 3 white LEDs for 20 fibers"),
        (WHITE + '[[constraints.fixed]]\nfiber = 1\ncolor = "red"', "color = red, allowed: white"),
    ],
)
def test_bad_colors_raise_one_clear_error(tmp_path: Path, more: str, message: str) -> None:
    assert message in refusal(tmp_path, more, ("white",) * 3)


def test_a_baseline_has_the_colors_of_its_scene(tmp_path: Path) -> None:
    text = refusal(tmp_path, WHITE, ("white", "amber", "red"))
    assert "baseline.tip = amber: allowed: white, off" in text
    assert "baseline.right = red: allowed: white, off" in text
    assert "allowed: red, green, blue" in refusal(tmp_path, "", ("white",) * 3, schema=1)


def test_new_keys_need_schema_2(tmp_path: Path) -> None:
    text = refusal(tmp_path, SAID, schema=1, camera='channels = ["red", "green", "blue"]')
    assert "colors needs schema = 2" in text
    assert "camera.channels needs schema = 2" in text
    assert "off needs schema = 2" in refusal(tmp_path, "[constraints]\noff = true", schema=1)
    fixed = '[[constraints.fixed]]\nfiber = 1\ncolor = "off"'
    assert "off needs schema = 2" in refusal(tmp_path, fixed, schema=1)


def test_texts_of_other_characters_raise_one_clear_error(tmp_path: Path) -> None:
    text = refusal(tmp_path, WHITE.replace('"white"', '"White"') + 'ink = "red"\n')
    assert (
        "colors.0.name = White, allowed: 1 to 32 of a-z, 0-9, _ and -, the first a letter" in text
    )
    assert "colors.0.ink = red, allowed: # and six digits 0-9 or a-f" in text


def test_pictures_of_all_channels_full_are_white() -> None:
    for count in (1, 2, 4, 6):
        channels = tuple(f"c{i}" for i in range(count))
        palette = Palette(("a",), ((1.0,) * count,), channels, ("#000000",))
        white = np.ones(count) @ palette.display
        assert white.max() == pytest.approx(1.0)
        assert count == 2 or white.min() == pytest.approx(1.0)
    np.testing.assert_array_equal(RGB.display, np.eye(3))


def test_an_led_of_a_known_color_has_its_ink_and_no_two_others_share_one(tmp_path: Path) -> None:
    leds = "".join(COLOR.format(name, "[1.0, 0.5, 0.2]") for name in ("warm", "amber", "cold"))
    palette = scene_with(tmp_path, leds, ("warm", "amber", "cold")).palette
    assert palette.ink("amber") == "#b9770e"
    assert len(set(palette.inks)) == 3


def test_a_baseline_without_light_is_refused(tmp_path: Path) -> None:
    assert "baseline: all lamps are off" in refusal(tmp_path, "", ("off",) * 3)
    scene_with(tmp_path, "", ("off", "off", "red"))
