"""A scene file that asks for what only schema 2 can say is told what would be right."""

from __future__ import annotations

from pathlib import Path

import pytest

from render.errors import SceneError
from render.scene import load_scene, scene_text

FINGER = scene_text("finger20")


def refusal(folder: Path, *changes: tuple[str, str], schema: int = 1) -> str:
    text = FINGER.replace("schema = 1", f"schema = {schema}")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    (folder / "scene.toml").write_text(text)
    with pytest.raises(SceneError) as caught:
        load_scene(folder / "scene.toml")
    return str(caught.value).partition("is not a valid scene: ")[2]


def test_another_led_is_told_that_colors_can_name_it(tmp_path: Path) -> None:
    amber = ('tip = "blue"', 'tip = "amber"')
    assert refusal(tmp_path, amber) == (
        "baseline.tip = amber: allowed: red, green, blue (other LEDs need schema = 2 and "
        "[[colors]] that name them)"
    )
    assert refusal(tmp_path, amber, schema=2) == (
        "baseline.tip = amber: allowed: red, green, blue, off (other LEDs need [[colors]] that "
        "name them)"
    )
    dark = ('tip = "blue"', 'tip = "off"')
    assert "(off needs schema = 2)" in refusal(tmp_path, dark)


def test_a_near_key_that_needs_schema_2_says_so(tmp_path: Path) -> None:
    colour = ("[baseline]", '[[colour]]\nname = "infrared"\n\n[baseline]')
    assert refusal(tmp_path, colour) == (
        "unknown key colour, did you mean colors, which needs schema = 2?"
    )
    assert refusal(tmp_path, colour, schema=2) == "unknown key colour, did you mean colors?"


def test_keys_that_a_file_of_schema_1_has_not_are_told_apart_from_those_it_has(
    tmp_path: Path,
) -> None:
    model = ("[camera]", '[camera]\nmodel = "fisheye"')
    newer = "position, look_at, direction, up, lens, channels, shots, read_noise, full_well, bits, "
    newer += "longest_exposure, gains, saturated, exposure_time, line_time"
    told = "unknown key camera.model, allowed: distance, y, field_of_view, columns, rows"
    assert refusal(tmp_path, model) == f"{told} (with schema = 2 also {newer})"
    assert refusal(tmp_path, model, schema=2) == f"{told}, {newer}"
    edges = ("[diffuser]", '[diffuser]\nedges = ["left"]')
    assert refusal(tmp_path, edges).endswith("sigma_s, sigma_a, g (with schema = 2 also on)")
    assert "lamps, lamps_file, colors, search, parts)" in refusal(
        tmp_path, ("[camera]", "[leds]\n[camera]")
    )


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("tip = 4", "tip = 4\nbase = 6", '([[rows]] of schema = 2 can have edge = "base")'),
        ("tip = 4", 'tip = 4\nprofile = "lambertian"', "([[rows]] of schema = 2 have profile)"),
        ("left = 8", "left = [-3.0, 3.0]",
         "a whole number ([[rows]] of schema = 2 can have lamps at places of their own)"),
        ("height = { value = 2.0", "height = { value = -1.0",
         "fibers.height = -1.0: allowed: 0 to 100 mm ([[rows]] of schema = 2 can have -100 to "
         "100 mm)"),
        ("tilt = { value = 10.0", "tilt = { value = [10.0, 5.0]",
         "a number ([[rows]] of schema = 2 have a tilt each)"),
        ("gap = { value = 0.4", "gap = { value = 0.2", "([[rows]] of schema = 2 need not turn)"),
    ],
)  # fmt: skip
def test_what_fibers_cannot_do_is_told_that_rows_can(
    tmp_path: Path, old: str, new: str, told: str
) -> None:
    assert told in refusal(tmp_path, (old, new))


def test_what_rows_cannot_do_either_has_no_hint(tmp_path: Path) -> None:
    tilt = ("tilt = { value = 10.0", "tilt = { value = 95.0")
    assert refusal(tmp_path, tilt) == "fibers.tilt = 95.0: allowed: -60 to 60 deg"


def test_a_gray_camera_is_told_that_its_leds_are_missing(tmp_path: Path) -> None:
    gray = ("[camera]", '[camera]\nchannels = ["gray"]')
    assert refusal(tmp_path, gray, schema=2) == (
        "missing [[colors]]: camera.channels = gray, and a scene without [[colors]] has LEDs red, "
        "green and blue of three channels, allowed: [[colors]] whose response has 1 value, one "
        "per channel"
    )
