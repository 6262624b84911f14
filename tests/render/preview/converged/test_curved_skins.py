"""Light paths to skins that are not flat: where they end, and how much light gets there."""

from __future__ import annotations

import numpy as np
import pytest

from render.geometry import SkinChart
from render.preview.converged.arrivals import arrivals, flown, receivers_at
from render.preview.converged.block import (
    bent_block,
    directions_to_block,
    patch_areas,
    to_block,
)
from render.preview.converged.walks import find_coating
from render.scene import Scene
from tests.oracles.mesh_cells import BentScene
from tests.oracles.mesh_tracer import trace_photons_on_mesh
from tests.oracles.pads import SKINS, content_of_case, scene_of_case

PHI = 1.2


def rays_in_pad(scene: Scene, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return starts ``(ray, 3)`` mm anywhere in the pad, and directions of any slope."""
    rng = np.random.default_rng(8)
    uv = (rng.random((count, 2)) - 0.5) * [scene.pad.width, scene.pad.length]
    high = SkinChart(scene, 0.0).height(uv) * (1.0 - 1e-6 - rng.random(count) ** 2)
    along = rng.normal(size=(count, 3))
    inside = high > 1e-3
    start = np.column_stack([uv, high])[inside]
    return start, (along / np.linalg.norm(along, axis=1, keepdims=True))[inside]


def way_to_skin(scene: Scene, start: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Return the way ``(ray,)`` mm to a sphere or cylinder, or by the chart to a mesh."""
    skin = scene.skin
    assert skin is not None
    if skin.radius is None:
        return SkinChart(scene, 0.0).way(start, along)
    # A cylinder is a sphere of what goes across its axis.
    across = [axis for axis in range(3) if skin.axis is None or axis != "xy".index(skin.axis)]
    center = np.array([0.0, 0.0, scene.pad.thickness - skin.radius])
    p, d = (start - center)[:, across], along[:, across]
    a, b = (d * d).sum(axis=1), (p * d).sum(axis=1)
    way = (np.sqrt(b * b + a * (skin.radius**2 - (p * p).sum(axis=1))) - b) / a
    # What leaves by an edge before, or misses the pad's part of it, does not end there.
    half = 0.5 * np.array([scene.pad.width, scene.pad.length])
    end = start + way[:, None] * along
    inside = (np.abs(end[:, :2]) <= half).all(axis=1) & (end[:, 2] > 0.0)
    return np.where(inside, way, np.inf)


@pytest.mark.parametrize("case", [*SKINS, "arch along x rough 0.1"])
def test_rays_end_where_they_cross_the_skin(case: str) -> None:
    scene = scene_of_case(case)
    chart, block = SkinChart(scene, 0.0), bent_block(scene, 0.0, pressed=False)
    start, along = rays_in_pad(scene, 4000)
    points, normals = np.zeros_like(start), np.zeros_like(start)
    weights = np.zeros(len(start))
    find_coating(
        block, to_block(scene, start), directions_to_block(along), points, normals, weights
    )
    way = way_to_skin(scene, start, along)
    # Not those that leave by the lower face before.
    met = np.isfinite(way) & (
        (start + np.where(np.isfinite(way), way, 0.0)[:, None] * along)[:, 2] > 0
    )
    assert 0.3 < met.mean() < 0.9
    # The skin is bilinear on its grid, 1e-4 mm off; rays that skim it meet it a little apart.
    assert (weights == met).mean() > 0.999
    met &= weights == 1.0
    end = start[met] + way[met, None] * along[met]
    assert np.quantile(np.abs(points[met] - to_block(scene, end)), 0.99) < 2e-3
    inwards = directions_to_block(-chart.frames(chart.uv(end))[..., 2])
    assert np.quantile(np.abs(normals[met] - inwards), 0.99) < 1e-3


@pytest.mark.parametrize(
    "case",
    ["arch along x rough 0.1", pytest.param("dome", marks=pytest.mark.slow),
     pytest.param("mesh", marks=pytest.mark.slow)],
)  # fmt: skip
def test_as_much_light_gets_to_the_skin_as_analog_photons_bring(case: str) -> None:
    content, photons = content_of_case(case), 240_000
    content["coating"]["albedo"]["value"] = 0.001  # what is reflected would arrive again
    scene = Scene.model_validate(content)
    blocks = bent_block(scene, 0.0, pressed=False), bent_block(scene, 0.0, pressed=True)
    receivers, areas = receivers_at(scene, 0.0), patch_areas(scene)
    mesh = BentScene(scene, 0.0, indented=False)
    for lamp in range(scene.lamp_count):
        phi, numbers = np.array([PHI]), range(photons)
        brought = flown(scene, 0.0, lamp, phi, *blocks, receivers, photons, numbers)
        found = arrivals(scene, brought).whole
        light = np.pi * (found.patches[:, 0] * areas).sum()
        truth, _ = trace_photons_on_mesh(
            mesh.pad, mesh.lamp(lamp, PHI), mesh.place(lamp), photons, 5, len(mesh.area)
        )
        power = truth.sum()
        noise = np.sqrt(2.0 * power * (1.0 - power) / photons)
        assert light == pytest.approx(power, abs=4.0 * noise + 1e-3)


def test_patches_of_a_dome_have_its_area() -> None:
    scene = scene_of_case("dome")
    assert scene.skin is not None
    radius, half = scene.skin.radius, 0.5 * np.array([scene.pad.width, scene.pad.length])
    # Of z = sqrt(R^2 - x^2 - y^2): the integral of R / z over the rectangle.
    x, y = (side * (np.arange(800) + 0.5) / 800 for side in half)
    z = np.sqrt(radius**2 - x[:, None] ** 2 - y**2)
    expected = 4.0 * half.prod() * (radius / z).mean()
    assert patch_areas(scene).sum() == pytest.approx(expected, rel=1e-4)
