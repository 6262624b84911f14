"""Light that the shader refracts between a pad and its window."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from render.choose_exposure import ScoreScale, scene_scale
from render.geometry import counted_sites, flat_fiber_poses, fresnel
from render.preview import Preview
from render.preview.converged import Effort
from render.preview.facet_blur import facet_blur
from render.preview.shading_points import ShadingPoints
from render.scene import Scene, unchecked
from tests.oracles.pads import content_of_case, scene_of_case

PHI = np.array([1.2])


def with_index(case: str, index: float) -> Scene:
    """Return a case with a window of ``index``."""
    scene = scene_of_case(case)
    assert scene.window is not None
    return unchecked(scene, {"window": unchecked(scene.window, {"index": index})})


def direct(scene: Scene) -> tuple[np.ndarray, ShadingPoints]:
    """Return irradiance ``(lamp, point)`` on facets and sites before the coating reflects any."""
    with Preview(scene) as preview:
        drawn = preview.direct_irradiance(np.full((scene.lamp_count, 1), PHI[0]), 0.0)
        points = preview._points
    return drawn[:, 0, : points.first_patch, 0], points


@pytest.mark.parametrize("case", ["window", "window lit at its edges", "window lit from below"])
def test_a_window_of_nearly_the_pads_index_is_more_of_the_pad(case: str) -> None:
    # The shader bends light at two faces in one of them, at one in the other.
    nearly, same = (direct(with_index(case, index))[0] for index in (1.41001, 1.41))
    ratio = (nearly / same)[same > 0.05 * same.max()]
    assert len(ratio) > 20
    np.testing.assert_allclose(np.median(ratio), 1.0, atol=0.002)
    assert np.quantile(np.abs(ratio - 1.0), 0.9) < 0.02
    assert ratio.max() < 1.01


def test_a_lamp_far_below_comes_through_three_faces_as_snell_and_fresnel_say() -> None:
    scene = with_index("window lit from below", 1.6)
    assert scene.lamps is not None
    assert scene.window is not None
    far = unchecked(scene.lamps[0], {"position": (0.0, 0.0, -400.0), "direction": (0.0, 0.0, 1.0)})
    scene = unchecked(scene, {"lamps": (far,)})
    lit, points = direct(scene)
    site = lit[0, points.sites * points.facets :]
    # Nearly upright light: what the two faces pass, over the square of the distance in air, into
    # which a medium counts as its thickness over its index.
    passed = (1 - fresnel(np.ones(1), 1.6)[0]) * (1 - fresnel(np.ones(1), 1.41 / 1.6)[0])
    distance = 397.0 + 3.0 / 1.6 + 4.5 / 1.41
    np.testing.assert_allclose(site, passed[0] / np.pi / distance**2, rtol=0.004)


def refracted(
    way: np.ndarray, axis: int, before: float, behind: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return unit directions ``(ray, 3)`` behind a face across ``axis``, and what passes it."""
    bent = way * (before / behind)
    rest = 1.0 - (bent**2).sum(axis=1) + bent[:, axis] ** 2
    passed = 1.0 - fresnel(np.abs(way[:, axis]), behind / before)[0]
    bent[:, axis] = np.sign(way[:, axis]) * np.sqrt(np.maximum(rest, 0.0))
    return bent, np.where(rest > 0.0, passed, 0.0)


def test_light_that_enters_an_edge_of_the_window_lands_where_its_rays_do() -> None:
    # One small Lambertian lamp, and black walls but for its own, which send back nothing.
    content = content_of_case("window lit at its edges")
    content["rows"] = content["rows"][:1]
    content["rows"][0]["diameter"]["value"] = 0.05
    content["baseline"] = {"left": "red"}
    content["faces"] = [{"on": ["tip", "right", "base"], "black": True}]
    scene = Scene.model_validate(content)
    lit, points = direct(scene)
    sites = points.position[points.sites * points.facets : points.first_patch] - [0.0, 0.0, 3.0]

    poses = flat_fiber_poses(scene)
    beam = poses.directions(PHI)[0]
    steps = (np.arange(1500) + 0.5) / 1500
    up, across = (np.pi * (part.ravel() - 0.5) for part in np.meshgrid(steps, steps))
    way = np.stack([np.cos(up) * np.cos(across), np.cos(up) * np.sin(across), np.sin(up)], axis=1)
    power = np.cos(up) * np.maximum(way @ beam, 0.0) / np.pi * (np.pi / 1500) ** 2
    at = poses.position[0] + way * (poses.gap[0] / way[:, :1])
    found = np.zeros(len(sites))

    def land(start: np.ndarray, way: np.ndarray, power: np.ndarray) -> None:
        with np.errstate(divide="ignore", invalid="ignore"):
            landing = start[:, :2] + way[:, :2] * ((4.5 - start[:, 2:]) / way[:, 2:])
        for number, site in enumerate(sites):
            near = np.linalg.norm(landing - site[:2], axis=1) < 0.25
            found[number] += power[near].sum() / (np.pi * 0.25**2)

    # Steeply up before the edge of the window, and into the pad's.
    pad = (at[:, 2] > 0.0) & (at[:, 2] < 4.5)
    inside, passed = refracted(way[pad], 0, 1.0, 1.41)
    land(at[pad], inside, power[pad] * passed)
    window = (at[:, 2] > -3.0) & (at[:, 2] < 0.0)
    at, power = at[window], power[window]
    way, passed = refracted(way[window], 0, 1.0, 1.49)
    power *= passed
    down = way[:, 2] < 0.0
    power[down] *= 1.0 - refracted(way[down], 2, 1.49, 1.0)[1]
    at[down] += way[down] * ((-3.0 - at[down, 2:]) / way[down, 2:])
    way[:, 2] = np.abs(way[:, 2])
    at += way * (-at[:, 2:] / way[:, 2:])
    inside, passed = refracted(way, 2, 1.49, 1.41)
    land(at, inside, power * passed)
    np.testing.assert_allclose(lit[0, points.sites * points.facets :], found, rtol=0.04)


def test_the_camera_sees_through_both_faces() -> None:
    scene = with_index("window", 1.7)
    blur = facet_blur(scene, 0.0)
    passed = (1 - fresnel(np.ones(1), 1.7)[0]) * (1 - fresnel(np.ones(1), 1.41 / 1.7)[0])
    head_on = scene.coating.albedo / np.pi / 1.41**2 * passed[0]
    np.testing.assert_allclose(blur[:, -1, -1], head_on, rtol=0.03)
    # Smooth faces show every facet alone.
    faces = range(scene.indenter.faces)
    assert (blur[:, faces, faces] > 0.9 * head_on).all()
    assert len(blur) == len(counted_sites(scene))


def test_a_rough_window_mixes_facets_but_loses_no_light() -> None:
    smooth, rough = (
        facet_blur(scene_of_case(case), 0.0) for case in ("window", "window rough 0.1")
    )
    np.testing.assert_allclose(rough.sum(axis=-1), smooth.sum(axis=-1), rtol=0.01)
    faces = np.arange(rough.shape[1] - 1)
    assert (rough[:, faces, faces] < smooth[:, faces, faces]).all()


def test_a_picture_through_the_window_shows_what_the_camera_sees_of_a_site() -> None:
    scene = scene_of_case("window lit at its edges")
    power = np.ones((scene.lamp_count, 3))
    phi = np.full(scene.lamp_count, PHI[0])
    columns, rows = scene.camera.columns, scene.camera.rows
    with Preview(scene) as preview:
        _, background = preview.transport(PHI, np.zeros(1))
        picture = preview.picture(phi, power, 0.0, columns, rows, indented=False)
    lit = picture[..., 0] > 0.0
    assert 0.2 < lit.mean() < 1.0
    # The six sites lie within what is drawn, and are as bright as their cells say.
    cells = background.sum(axis=0).ravel()
    assert picture[..., 0].max() > 0.9 * cells.max()
    middle = picture[rows // 2 - 5 : rows // 2 + 5, columns // 2 - 5 : columns // 2 + 5, 0].mean()
    assert 0.5 * cells.min() < middle < 2.0 * cells.max()


def test_the_scale_is_that_of_light_that_is_followed_through_the_window(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    few = Effort(paths=1024, arrivals=300_000, rounds=1)
    monkeypatch.setattr("render.preview.converged.cache.FEW_PATHS", few)

    def scale(index: float) -> ScoreScale:
        content = content_of_case("window lit at its edges")
        content["baseline"]["tip"] = "green"
        content["window"]["index"]["value"] = index
        return scene_scale(Scene.model_validate(content))

    same, nearly, other = scale(1.41), scale(1.41001), scale(1.49)
    assert nearly.exposure == pytest.approx(same.exposure, rel=0.08)
    # Light that a window of the pad's index would let pass is reflected at this one's bond.
    assert other.exposure > 1.15 * nearly.exposure
    assert scale(1.49) == other
