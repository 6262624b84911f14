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
from render.geometry import bend_points, facets, fiber_poses
from render.scene import Scene
from tests.oracles.pads import scene_of_case

COUNT = 1 << 18


def aim_of(scene: Scene, bend: float = 0.0) -> LampAim:
    return LampAim(scene, bend, LowerFaceMirror(scene, bend))


def lanes(mono: ModuleType, point: np.ndarray, count: int) -> Any:
    return mono.Point3f(np.repeat(point[:, None], count, axis=1).astype(np.float32))


def numbers(mono: ModuleType, count: int, seed: int) -> list[Any]:
    rng = np.random.default_rng(seed)
    return [mono.Float(rng.random(count).astype(np.float32)) for _ in range(3)]


@pytest.mark.parametrize("case", ["smooth", "rough 0.1", "no face", "half below"])
@pytest.mark.parametrize("bend", [0.0, np.pi / 2])
def test_the_density_is_that_of_the_aimed_directions(
    mono: ModuleType, case: str, bend: float
) -> None:
    scene = scene_of_case(case)
    aim = aim_of(scene, bend)
    a = lanes(mono, facets(scene, bend).centroid[1, 2], COUNT)
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
    drawn = aim_of(scene).sample(fiber, a, dr.zeros(mono.Float, COUNT), x, y)
    meets = np.array(light.passed(fiber, a, drawn, mono.Float(np.inf)))
    assert meets.mean() > 1 / 3


def test_directions_follow_snells_law_to_the_center_of_the_lamp(mono: ModuleType) -> None:
    scene = scene_of_case("far lamp")
    aim = aim_of(scene)
    a = facets(scene, 0.0).site_position[1]
    fiber = mono.UInt32([0])
    # The axis of the direct lobe: the radius of the t distribution is 0 for the number 0.
    zero = mono.Float([0.0])
    d = np.array(aim.sample(fiber, lanes(mono, a, 1), zero, zero, zero), dtype=np.float64)[:, 0]
    wall = -scene.pad.width / 2
    at_wall = a + d * (wall - a[0]) / d[0]
    tangential = scene.pad.index * d[1:]
    out = np.array([-np.sqrt(1 - tangential @ tangential), *tangential])
    lamp = np.array(light_center(scene))
    arrived = at_wall + out * (lamp[0] - at_wall[0]) / out[0]
    np.testing.assert_allclose(arrived, lamp, atol=2e-3)


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("case", ["window", "window lit at its edges", "window of low index"])
def test_directions_are_bent_at_the_bond_of_a_window(
    mono: ModuleType, case: str, mirrored: bool
) -> None:
    scene = scene_of_case(case)
    aim, sites = aim_of(scene), facets(scene, 0.0).site_position
    poses = fiber_poses(scene, 0.0)
    way, zero = aim.main_ways[int(mirrored)], mono.Float([0.0])
    assert way.mirrored == mirrored
    off = []
    for number, lamp in enumerate(poses.position):
        for a in sites:
            drawn = aim.sample_way(mono.UInt32([number]), lanes(mono, a, 1), way, zero, zero)
            d = np.array(drawn, dtype=np.float64)[:, 0]
            arrived = beyond_the_wall(scene, a, d, lamp, poses.foot[number])
            # What would be mirrored beyond the wall is aimed at the lamp's image below the window.
            image = lamp * [1.0, 1.0, -1.0] - [0.0, 0.0, 6.0]
            ends = [lamp, image] if mirrored else [lamp]
            off.append(min(np.linalg.norm(arrived - end) for end in ends))
    # A lobe is 0.35 mm wide at these lamps.
    assert np.nanmax(off) < 0.02
    assert np.isfinite(off).mean() > 1 / 3


@pytest.mark.parametrize("mirrored", [False, True])
def test_a_third_of_the_directions_over_a_bond_meet_the_lamp(
    mono: ModuleType, mirrored: bool
) -> None:
    scene, count = scene_of_case("window lit at its edges"), 400
    poses, a = fiber_poses(scene, 0.0), facets(scene, 0.0).site_position[1]
    aim = aim_of(scene)
    _, x, y = numbers(mono, count, 3)
    for number in (1, 2):
        lamp = poses.position[number]
        fiber = mono.UInt32(np.full(count, number, dtype=np.uint32))
        way = aim.main_ways[int(mirrored)]
        drawn = np.array(aim.sample_way(fiber, lanes(mono, a, count), way, x, y), dtype=np.float64)
        image = lamp * [1.0, 1.0, -1.0] - [0.0, 0.0, 6.0]
        ends = [lamp, image] if mirrored else [lamp]
        met = 0
        for d in drawn.T:
            arrived = beyond_the_wall(scene, a, d, lamp, poses.foot[number])
            met += min(np.linalg.norm(arrived - end) for end in ends) < poses.radius[number]
        assert 0.3 < met / count < 0.8


def test_lamps_in_the_silicone_are_aimed_at_where_the_bond_shows_them(mono: ModuleType) -> None:
    scene, count = scene_of_case("cast in over a window"), 400
    poses, a = fiber_poses(scene, 0.0), facets(scene, 0.0).site_position[1]
    aim = aim_of(scene)
    _, x, y = numbers(mono, count, 3)
    (way,) = [way for way in aim.ways if way.by_bond and not way.wall and not way.opposite]
    for number in range(scene.lamp_count):
        fiber = mono.UInt32(np.full(count, number, dtype=np.uint32))
        drawn = np.array(aim.sample_way(fiber, lanes(mono, a, count), way, x, y), dtype=np.float64)
        span = poses.position[number] * [1.0, 1.0, -1.0] - a
        off = np.linalg.norm(span[:, None] - (span @ drawn) * drawn, axis=0)
        assert (off < poses.radius[number]).mean() > 1 / 3


def beyond_the_wall(
    scene: Scene, a: np.ndarray, d: np.ndarray, lamp: np.ndarray, foot: np.ndarray
) -> np.ndarray:
    """Return where light from ``a`` along ``d`` passes a lamp's plane, layer by layer.

    Along faces wave vectors stay, k = n d. NaN where the wall lets little of it out, along itself.
    """
    assert scene.window is not None
    axis = int(np.abs(lamp - foot).argmax())
    k, place, up = scene.pad.index * d, np.array(a), -1.0
    index, low, high = scene.pad.index, 0.0, a[2]
    for _ in range(6):
        level = low if up < 0 else high
        to_level = (level - place[2]) / k[2] if k[2] else np.inf
        to_wall = (foot[axis] - place[axis]) / k[axis]
        place = place + min(to_level, to_wall) * k
        if to_wall <= to_level:
            break
        if level == 0.0:
            below = up < 0
            index = scene.window.index if below else scene.pad.index
            low, high = (-3.0, 0.0) if below else (0.0, a[2])
            k[2] = up * np.sqrt(index**2 - k[:2] @ k[:2])
        else:
            up, k[2] = -up, -k[2]
    assert place[axis] == pytest.approx(foot[axis])
    across = np.delete(k, axis) @ np.delete(k, axis)
    if across > 0.97:
        return np.full(3, np.nan)
    out = np.array(k)
    out[axis] = np.sign(k[axis]) * np.sqrt(1.0 - across)
    return np.asarray(place + out * (lamp[axis] - foot[axis]) / out[axis])


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


def bent_end(scene: Scene, bend: float, edge: str) -> tuple[np.ndarray, np.ndarray]:
    """Return a point of a wall of a bent pad and its outward normal, from three of its points."""
    width, length, thickness = scene.pad.width / 2, scene.pad.length / 2, scene.pad.thickness
    place = {
        "left": [[-width, y, z] for y, z in ((-1.0, 0.0), (1.0, 0.0), (0.0, thickness))],
        "right": [[width, y, z] for y, z in ((-1.0, 0.0), (1.0, 0.0), (0.0, thickness))],
        "tip": [[x, length, z] for x, z in ((-1.0, 0.0), (1.0, 0.0), (0.0, thickness))],
        "base": [[x, -length, z] for x, z in ((-1.0, 0.0), (1.0, 0.0), (0.0, thickness))],
    }[edge]
    a, b, c = bend_points(scene, np.array(place), bend)
    normal = np.cross(b - a, c - a)
    middle = bend_points(scene, np.array([0.0, 0.0, thickness / 2]), bend)
    return a, normal / np.linalg.norm(normal) * np.sign((a - middle) @ normal)


@pytest.mark.parametrize("bend", [0.0, np.pi / 4])
@pytest.mark.parametrize(
    ("fiber", "edge", "over", "wall", "opposite"),
    [(0, "left", "base", -1, 0), (0, "left", "tip", 1, 0), (0, "left", "right", 0, 1),
     (1, "tip", "left", -1, 0), (1, "tip", "right", 1, 0), (1, "tip", "base", 0, 1)],
)  # fmt: skip
def test_directions_are_aimed_over_walls_and_ends(
    mono: ModuleType, bend: float, fiber: int, edge: str, over: str, wall: int, opposite: int
) -> None:
    """Followed to the wall, back to the lamp's face and out by Snell's law, plane by plane."""
    scene = scene_of_case("far lamp")
    aim, a = aim_of(scene, bend), facets(scene, bend).site_position[1]
    (way,) = [
        way for way in aim.ways
        if (way.wall, way.opposite, way.mirrored, way.below) == (wall, opposite, False, False)
    ]  # fmt: skip
    zero = mono.Float([0.0])
    drawn = aim.sample_way(mono.UInt32([fiber]), lanes(mono, a, 1), way, zero, zero)
    d = np.array(drawn, dtype=np.float64)[:, 0]
    place, normal = bent_end(scene, bend, over)
    assert d @ normal > 0
    met = a + d * ((place - a) @ normal) / (d @ normal)
    d = d - 2.0 * (d @ normal) * normal
    place, normal = bent_end(scene, bend, edge)
    left = met + d * ((place - met) @ normal) / (d @ normal)
    along = scene.pad.index * (d - (d @ normal) * normal)
    out = along + np.sqrt(1.0 - along @ along) * normal
    lamp = fiber_poses(scene, bend).position[fiber]
    arrived = left + out * ((lamp - left) @ normal) / (out @ normal)
    np.testing.assert_allclose(arrived, lamp, atol=5e-3)
