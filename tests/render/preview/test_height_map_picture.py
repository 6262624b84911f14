"""A height map in pictures: as the planes of the same body, and as level 2 sees it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import render.preview.lights
from render.geometry import HeightMap, Imprint, probe, smoothed_skin
from render.preview import Preview
from render.scene import Scene, load_scene


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("finger20")


@pytest.fixture(autouse=True)
def few_rays(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(render.preview.lights, "RAYS", 20_000)


def drawn(
    scene: Scene, body: Imprint | HeightMap, bend: float, cache: Path, indented: bool = True
) -> np.ndarray:
    phi = np.full(scene.lamp_count, np.pi / 2)
    power = np.zeros((scene.lamp_count, 3))
    power[np.arange(scene.lamp_count), np.repeat([0, 2, 1], [8, 4, 8])] = 1.0
    with Preview(scene, cache=cache, imprint=body) as preview:
        return preview.picture(phi, power, bend, 90, 150, indented=indented).astype(float)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "bend"), [("bolt", 0.0), ("edge", np.pi / 2)])
def test_a_map_without_smoothing_looks_like_the_planes_it_was_made_of(
    scene: Scene, name: str, bend: float, tmp_path: Path
) -> None:
    body = probe(scene, name)
    assert isinstance(body, Imprint)
    planes = drawn(scene, body, bend, tmp_path)
    skin = drawn(scene, smoothed_skin(scene, body, 0.0), bend, tmp_path)
    plain = drawn(scene, body, bend, tmp_path, indented=False)
    changed = (plain > 0) & (np.abs(planes / np.where(plain > 0, plain, 1) - 1) > 0.1)
    assert changed.sum() > 200
    apart = skin[changed] / planes[changed] - 1
    assert abs(np.median(apart)) < 0.02
    # Borders of facets lie within pixels.
    assert np.percentile(np.abs(apart), 75) < 0.06
    np.testing.assert_array_equal(skin > 0, planes > 0)


@pytest.mark.slow
@pytest.mark.parametrize("bend", [0.0, np.pi / 2])
def test_smooth_skin_has_the_light_of_level_2(scene: Scene, bend: float, tmp_path: Path) -> None:
    from render.reference import render_image

    skin = probe(scene, "ball", 1.2, 0.4)
    assert isinstance(skin, HeightMap)
    phi = np.full(scene.lamp_count, np.pi / 2)
    left = np.zeros((scene.lamp_count, 3))
    left[:8, 0] = left[12:, 1] = 1.0
    found = render_image(
        scene, phi, left, bend, width=36, height=60, samples=150, imprint=skin, seed=3
    )
    with Preview(scene, cache=tmp_path, imprint=skin) as preview:
        fine = preview.picture(phi, left, bend, 180, 300).astype(float)
    coarse = fine.reshape(60, 5, 36, 5, 3).mean(axis=(1, 3))
    # Where the skin slopes: left and right half of the imprint, summed.
    sloped = found.coated & (np.abs(found.normal[..., 0]) > 0.25)
    for sign, channel in ((1, 0), (-1, 0), (1, 1), (-1, 1)):
        half = sloped & (sign * found.normal[..., 0] > 0)
        assert half.sum() > 8
        truth = found.radiance[half, channel].sum()
        noise = np.sqrt((found.se[half, channel] ** 2).sum())
        assert coarse[half, channel].sum() == pytest.approx(truth, abs=3 * noise + 0.1 * truth)
