"""Light that is drawn once and superposed is what is drawn for each design."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import render.preview.lights
import render.preview.superposition
from render.preview import Preview
from render.scene import Scene, Window, load_scene, unchecked
from tests.oracles.pads import scene_of_case

SIZE = 30, 24


def with_lobe(scene: Scene) -> Scene:
    """Return a scene whose skin has a lobe, and another albedo for each channel."""
    lobe = {"albedo": (0.5, 0.3, 0.1), "specular": 0.3, "roughness": 0.25}
    return unchecked(scene, {"coating": unchecked(scene.coating, lobe)})


def on_window(scene: Scene) -> Scene:
    """Return a scene on a plate of another index."""
    window = Window.model_construct(thickness=2.0, index=scene.pad.index + 0.1)
    return unchecked(scene, {"window": window})


def pictures(scene: Scene, cache: Path) -> list[np.ndarray]:
    rng, found = np.random.default_rng(3), []
    with Preview(scene, cache=cache) as preview:
        for _ in range(2):
            phi = rng.uniform(0.4, 2.7, scene.lamp_count)
            power = rng.uniform(0.0, 1.0, (scene.lamp_count, 3))
            found.append(preview.picture(phi, power, 0.0, *SIZE).astype(float))
    return found


@pytest.mark.parametrize(
    "scene",
    [
        load_scene("finger20"),
        load_scene("digit"),
        load_scene("finger24"),
        scene_of_case("dome"),
        with_lobe(load_scene("digit-dome")),
        on_window(load_scene("digit")),
    ],
    ids=[
        "glow",
        "fixed lamps",
        "glow and beams that turn",
        "beams that turn on a dome",
        "lobes on a dome",
        "fixed lamps through a window",
    ],
)
def test_superposed_light_is_what_is_drawn(
    scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(render.preview.lights, "RAYS", 5_000)
    superposed = pictures(scene, tmp_path)
    monkeypatch.setattr(render.preview.superposition, "MAX_TABLE", 0)
    for one, other in zip(superposed, pictures(scene, tmp_path), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-5 * other.max())
        assert (other > 0).mean() > 0.1


def test_two_designs_of_one_view_differ(tmp_path: Path) -> None:
    one, other = pictures(load_scene("digit"), tmp_path)
    assert np.abs(one - other).max() > 0.1 * one.max()


def test_a_picture_none_of_whose_pixels_sees_the_pad_is_black(tmp_path: Path) -> None:
    scene = load_scene("digit")
    beside = {"position": (14.0, 0.0, -15.0), "direction": (0.0, 0.0, 1.0)}
    beside |= {"distance": None, "y": None}
    one = {"columns": 1, "rows": 1, "centre_x": 7.0}
    update = {
        "camera": unchecked(scene.camera, beside),
        "sites": unchecked(scene.sites, one),
    }
    power = np.ones((scene.lamp_count, 3))
    with Preview(unchecked(scene, update), cache=tmp_path) as preview:
        straight = np.full(scene.lamp_count, np.pi / 2)
        assert preview.picture(straight, power, 0.0, 9, 9).any()
        middle = preview.picture(straight, power, 0.0, 1, 1)
    assert middle.shape == (1, 1, 3)
    assert not middle.any()
