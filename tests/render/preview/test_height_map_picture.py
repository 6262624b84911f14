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


@pytest.mark.slow
def test_a_map_on_a_dome_looks_like_the_planes_it_was_made_of(tmp_path: Path) -> None:
    dome = load_scene("digit-dome")
    body = probe(dome, "bolt")
    assert isinstance(body, Imprint)

    def seen(press: Imprint | HeightMap, indented: bool = True) -> np.ndarray:
        with Preview(dome, cache=tmp_path, imprint=press) as preview:
            phi = np.full(3, np.pi / 2)
            return preview.picture(phi, np.eye(3), 0.0, 90, 120, indented).astype(float)

    planes, skin, plain = seen(body), seen(smoothed_skin(dome, body, 0.0)), seen(body, False)
    changed = (plain > 0) & (np.abs(planes / np.where(plain > 0, plain, 1) - 1) > 0.1)
    assert changed.sum() > 500
    # Where the bolt hides a lamp nearly all light is gone: the parts of the pad's mean.
    apart = (skin - planes)[changed] / plain[plain > 0].mean()
    assert abs(np.median(apart)) < 0.02
    assert np.percentile(np.abs(apart), 75) < 0.06


@pytest.mark.slow
def test_smooth_skin_on_a_dome_has_the_light_of_level_2(tmp_path: Path) -> None:
    from render.reference import render_image

    dome = load_scene("digit-dome")
    skin = probe(dome, "ball", 1.2, 0.4)
    assert isinstance(skin, HeightMap)
    phi, power = np.full(3, np.pi / 2), np.zeros((3, 3))
    power[0, 0] = power[1, 1] = power[2, 1] = 1.0  # the tip's lamp, and those of the base
    found = render_image(
        dome, phi, power, 0.0, width=45, height=60, samples=150, imprint=skin, seed=3
    )
    with Preview(dome, cache=tmp_path, imprint=skin) as preview:
        fine = preview.picture(phi, power, 0.0, 180, 240).astype(float)
    coarse = fine.reshape(60, 4, 45, 4, 3).mean(axis=(1, 3))
    # The ball's sides alone: the dome itself slopes by less there.
    row, column = np.indices(found.coated.shape)
    near = np.hypot(row - 29.5, column - 22.0) < 8.0
    lean = found.normal[..., 1]
    base, tip = (found.coated & near & (sign * lean > 0.25) for sign in (-1, 1))
    # What turns away from a lamp has a third of its light or less, of which the preview lacks some.
    for channel, lit, dark in ((0, tip, base), (1, base, tip)):
        truth = found.radiance[..., channel]
        assert truth[lit].sum() > 3 * truth[dark].sum() > 0
        for half in (lit, dark):
            noise = np.sqrt((found.se[half, channel] ** 2).sum())
            allowed = 3 * noise + 0.1 * truth[lit].sum()
            assert coarse[half, channel].sum() == pytest.approx(truth[half].sum(), abs=allowed)
