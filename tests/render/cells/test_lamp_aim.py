"""Directions are aimed at lamps with the density that they state, and most of them meet one."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import drjit as dr
import numpy as np
import pytest

from render.cells.fiber_light import FiberLight
from render.cells.lamp_aim import LampAim
from render.cells.lower_face_mirror import LowerFaceMirror
from render.geometry import facets, fiber_poses
from render.scene import Scene
from tests.oracles.pads import scene_of_case

COUNT = 1 << 18


def aim_of(scene: Scene) -> LampAim:
    return LampAim(scene, LowerFaceMirror(scene, 0.0))


def lanes(mono: ModuleType, point: np.ndarray, count: int) -> Any:
    return mono.Point3f(np.repeat(point[:, None], count, axis=1).astype(np.float32))


def vertex(mono: ModuleType, point: np.ndarray, count: int) -> Any:
    from render.paths.vertex import empty_vertex

    v = empty_vertex()
    v.p = lanes(mono, point, count)
    return v


def numbers(mono: ModuleType, count: int, seed: int) -> list[Any]:
    rng = np.random.default_rng(seed)
    return [mono.Float(rng.random(count).astype(np.float32)) for _ in range(3)]


@pytest.mark.parametrize("case", ["smooth", "rough 0.1", "no face", "half below"])
def test_the_density_is_that_of_the_aimed_directions(mono: ModuleType, case: str) -> None:
    scene = scene_of_case(case)
    aim = aim_of(scene)
    a = vertex(mono, facets(scene, 0.0).centroid[1, 2], COUNT)
    fiber = mono.UInt32(np.zeros(COUNT, dtype=np.uint32))
    pick, x, y = numbers(mono, COUNT, 1)
    drawn = aim.sample(fiber, a, pick, x, y)
    density = aim.density(fiber, a, drawn)
    dr.eval(drawn, density)
    drawn, density = np.array(drawn).T, np.array(density, dtype=np.float64)
    assert np.isfinite(density).all()
    assert (density > 0).all()
    # Over any region, the mean of 1 / density is the region's solid angle.
    axis = drawn[density.argmax()]
    for degrees in (1.0, 3.0, 10.0):
        inside = drawn @ axis > np.cos(np.radians(degrees))
        solid_angle = np.where(inside, 1 / density, 0.0)
        error = solid_angle.std() / np.sqrt(COUNT)
        expected = 2 * np.pi * (1 - np.cos(np.radians(degrees)))
        assert abs(solid_angle.mean() - expected) < 4 * error + 1e-3 * expected


def test_a_third_of_the_directions_through_no_face_meet_the_lamp(mono: ModuleType) -> None:
    scene = scene_of_case("no face")
    light = FiberLight(scene, np.full((2, 1), np.pi / 2), 0.0)
    a = lanes(mono, facets(scene, 0.0).site_position[1], COUNT)
    fiber = mono.UInt32(np.zeros(COUNT, dtype=np.uint32))
    # The first way is the direct one.
    _, x, y = numbers(mono, COUNT, 2)
    v = vertex(mono, facets(scene, 0.0).site_position[1], COUNT)
    drawn = aim_of(scene).sample(fiber, v, dr.zeros(mono.Float, COUNT), x, y)
    meets = np.array(light.passed(fiber, a, drawn, mono.Float(np.inf)))
    assert meets.mean() > 1 / 3


def test_directions_follow_snells_law_to_the_center_of_the_lamp(mono: ModuleType) -> None:
    scene = scene_of_case("far lamp")
    aim = aim_of(scene)
    a = facets(scene, 0.0).site_position[1]
    fiber = mono.UInt32([0])
    # The axis of the direct lobe: the radius of the t distribution is 0 for the number 0.
    zero = mono.Float([0.0])
    d = np.array(aim.sample(fiber, vertex(mono, a, 1), zero, zero, zero), dtype=np.float64)[:, 0]
    wall = -scene.pad.width / 2
    at_wall = a + d * (wall - a[0]) / d[0]
    tangential = scene.pad.index * d[1:]
    out = np.array([-np.sqrt(1 - tangential @ tangential), *tangential])
    lamp = np.array(light_center(scene))
    arrived = at_wall + out * (lamp[0] - at_wall[0]) / out[0]
    np.testing.assert_allclose(arrived, lamp, atol=2e-3)


def light_center(scene: Scene) -> list[float]:
    from render.geometry import fiber_poses

    center: list[float] = fiber_poses(scene, 0.0).position[0].tolist()
    return center


def test_lamps_in_the_silicone_are_aimed_at_over_each_wall_whatever_face_is_next(
    mono: ModuleType,
) -> None:
    """Axes of lobes end at images of the lamp, also of one that is nearest to the lower face."""
    scene = scene_of_case("cast in")
    aim, a = aim_of(scene), facets(scene, 0.0).site_position[1]
    zero = mono.Float([0.0])
    low, high = scene.box.low, scene.box.high
    for number, lamp in enumerate(scene.placed_lamps()):
        cells = set()
        for way in aim.ways:
            d = aim.sample_way(mono.UInt32([number]), lanes(mono, a, 1), way, zero, zero)
            direction = np.array(d, dtype=np.float64)[:, 0]
            images = [
                (cell, np.where(np.array(cell) % 2, low + high - lamp.position, lamp.position)
                 + np.array(cell) * (high - low))
                for cell in np.ndindex(3, 3, 2)
                for cell in [(cell[0] - 1, cell[1] - 1, -cell[2])]
            ]  # fmt: skip
            off = [
                np.linalg.norm(np.cross(image - a, direction)) / np.linalg.norm(image - a)
                for _, image in images
            ]
            assert min(off) < 1e-3
            cells.add(images[int(np.argmin(off))][0])
        assert len(cells) == 18


def end_of(scene: Scene, edge: str) -> tuple[np.ndarray, np.ndarray]:
    """Return a point of a wall of a pad and its outward normal."""
    width, length = scene.pad.width / 2, scene.pad.length / 2
    normal = {
        "left": [-1.0, 0.0, 0.0], "right": [1.0, 0.0, 0.0],
        "tip": [0.0, 1.0, 0.0], "base": [0.0, -1.0, 0.0],
    }[edge]  # fmt: skip
    return np.array(normal) * [width, length, 0.0], np.array(normal)


@pytest.mark.parametrize(
    ("fiber", "edge", "over", "wall", "opposite"),
    [(0, "left", "base", -1, 0), (0, "left", "tip", 1, 0), (0, "left", "right", 0, 1),
     (1, "tip", "left", -1, 0), (1, "tip", "right", 1, 0), (1, "tip", "base", 0, 1)],
)  # fmt: skip
def test_directions_are_aimed_over_walls_and_ends(
    mono: ModuleType, fiber: int, edge: str, over: str, wall: int, opposite: int
) -> None:
    """Followed to the wall, back to the lamp's face and out by Snell's law, plane by plane."""
    scene = scene_of_case("far lamp")
    aim, a = aim_of(scene), facets(scene, 0.0).site_position[1]
    (way,) = [
        way for way in aim.ways
        if (way.wall, way.opposite, way.mirrored, way.below) == (wall, opposite, False, False)
    ]  # fmt: skip
    zero = mono.Float([0.0])
    drawn = aim.sample_way(mono.UInt32([fiber]), lanes(mono, a, 1), way, zero, zero)
    d = np.array(drawn, dtype=np.float64)[:, 0]
    place, normal = end_of(scene, over)
    assert d @ normal > 0
    met = a + d * ((place - a) @ normal) / (d @ normal)
    d = d - 2.0 * (d @ normal) * normal
    place, normal = end_of(scene, edge)
    left = met + d * ((place - met) @ normal) / (d @ normal)
    along = scene.pad.index * (d - (d @ normal) * normal)
    out = along + np.sqrt(1.0 - along @ along) * normal
    lamp = fiber_poses(scene, 0.0).position[fiber]
    arrived = left + out * ((lamp - left) @ normal) / (out @ normal)
    np.testing.assert_allclose(arrived, lamp, atol=5e-3)
