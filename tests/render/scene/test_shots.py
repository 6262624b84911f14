"""Shots are channels of one picture: every set of them is a color of each LED, and no more."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest

from render.errors import SceneError
from render.scene import RGB, Palette, load_scene, scene_text
from render.scene.colors import palette_of, shot_patterns, with_shots
from tests.colored_scenes import COLOR


@pytest.mark.parametrize("shots", [1, 2, 3, 4])
def test_a_lamp_may_shine_in_every_set_of_shots_but_none(shots: int) -> None:
    every = [
        {shot for shot, lit in enumerate(chosen) if lit}
        for chosen in itertools.product([False, True], repeat=shots)
    ]
    found = [set(pattern) for pattern in shot_patterns(shots)]
    assert sorted(map(sorted, found)) == sorted(sorted(one) for one in every if one)
    assert found[0] == set(range(shots))


@pytest.mark.parametrize("shots", [1, 2, 3])
def test_a_shot_sees_what_its_lights_give_to_the_channels_of_one_picture(shots: int) -> None:
    one = Palette(
        ("white", "amber"), ((1.0, 0.9, 0.5), (1.0, 0.4, 0.0)), ("r", "g", "b"), ("",) * 2
    )
    default = load_scene("digit").with_(camera_shots=shots).palette
    assert (default.one_shot, with_shots(one, shots).one_shot) == (RGB, one)
    for palette in (default, with_shots(one, shots)):
        drive = np.random.default_rng(3).uniform(size=(5, len(palette.names)))
        seen = np.split(drive @ palette.matrix, shots, axis=1)
        for lights, light in zip(palette.in_shots(drive), seen, strict=True):
            assert np.allclose(lights @ palette.one_shot.matrix, light)


def test_names_say_the_led_and_its_shots() -> None:
    palette = palette_of(None, None, 3)
    assert len(palette.names) == 3 * 7
    for name, led in zip(palette.names, palette.led, strict=True):
        told, _, shots = name.partition("@")
        assert told == RGB.names[led]
        drive = np.eye(len(palette.names))[[palette.index(name)]]
        lit = palette.in_shots(drive)[:, 0].sum(axis=1).nonzero()[0] + 1
        assert "+".join(map(str, lit)) == (shots or "1+2+3")


def test_scenes_of_one_picture_keep_their_hash_and_others_have_their_own() -> None:
    scene = load_scene("digit")
    assert scene.with_(camera_shots=1).hash == scene.hash
    hashes = {scene.with_(camera_shots=shots).hash for shots in (1, 2, 3, 4)}
    assert len(hashes) == 4


def test_a_skin_of_several_albedos_has_them_in_every_shot() -> None:
    scene = load_scene("digit").with_(camera_shots=2, coating_albedo=(0.4, 0.5, 0.4))
    assert scene.albedo_of_channel == (0, 1, 0, 0, 1, 0)
    assert scene.palette.channels == ("red-1", "green-1", "blue-1", "red-2", "green-2", "blue-2")


def test_pictures_of_shots_stand_side_by_side() -> None:
    palette = palette_of(None, None, 2)
    picture = np.random.default_rng(0).uniform(size=(4, 5, 6))
    shown = palette.shown(picture)
    assert np.allclose(shown[:, :5], picture[..., :3])
    assert np.allclose(shown[:, 5:], picture[..., 3:])


GRAY = 'channels = ["a", "b", "c", "d", "e", "f"]'
SIX = COLOR.format("white", [1.0] * 6)


@pytest.mark.parametrize(
    ("camera", "told"),
    [
        ("shots = 0", "camera.shots = 0: allowed: 1 to 4"),
        ("shots = 5", "camera.shots = 5: allowed: 1 to 4"),
        ("shots = 2.5", "camera.shots = 2.5, allowed: a whole number"),
        ('shots = "two"', 'camera.shots = "two", allowed: a whole number'),
        ("shots = true", "camera.shots = true, allowed: a whole number"),
        (
            f"shots = 4\n{GRAY}",
            "camera.shots = 4 of 6 channels have 24, allowed: at most 16, which is "
            "camera.shots = 2",
        ),
    ],
)
def test_shots_that_no_camera_takes_are_refused_in_one_sentence(
    tmp_path: Path, camera: str, told: str
) -> None:
    text = scene_text("digit").replace("[camera]", f"[camera]\n{camera}")
    if GRAY in camera:
        text = text.replace("[camera]", f"{SIX}\n[camera]", 1)
        for color in RGB.names:
            text = text.replace(f'"{color}"', '"white"')
    (tmp_path / "mine.toml").write_text(text)
    with pytest.raises(SceneError) as caught:
        load_scene(tmp_path / "mine.toml")
    assert told in str(caught.value)


def test_a_baseline_names_shots_that_there_are(tmp_path: Path) -> None:
    text = scene_text("digit").replace("[camera]", "[camera]\nshots = 2")
    (tmp_path / "mine.toml").write_text(text.replace('"red"', '"red@2"'))
    assert "red@2" in load_scene(tmp_path / "mine.toml").baseline_colors()
    (tmp_path / "mine.toml").write_text(text.replace('"red"', '"red@3"'))
    with pytest.raises(SceneError, match=r"red@3: allowed: red, red@1, red@2, green"):
        load_scene(tmp_path / "mine.toml")
