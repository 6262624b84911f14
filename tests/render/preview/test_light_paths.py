"""The light paths against world geometry: bend_points, brute-force reflection, traced rays."""

import numpy as np
import pytest

from render.geometry import bend_frames, bend_points, curvature
from render.preview.light_paths import direct_path, meets_edges, mirrored_path, wall_image
from render.scene import Scene, load_scene
from tests.oracles.pads import scene_of_case

SOURCE = np.array([-9.0, 5.0, 2.5])
TARGETS = np.array([[0.0, 3.0, 4.0], [3.0, 9.0, 3.9], [-3.0, -2.0, 4.0], [9.0, 4.0, 1.0]])
BENDS = [0.0, 1e-6, 0.4, np.pi / 2]


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("finger20")


def world(scene: Scene, flat: np.ndarray, local: np.ndarray, bend: float) -> np.ndarray:
    return np.einsum("...ij,...j->...i", bend_frames(scene, flat[..., 1], bend), local)


def reflection(scene: Scene, source: np.ndarray, target: np.ndarray, bend: float) -> np.ndarray:
    """Return the point of the lower face with the shortest way (Fermat), by refined search."""
    low = np.minimum(source, target)[:2] - 0.01
    high = np.maximum(source, target)[:2] + 0.01
    for _ in range(25):
        x, y = (np.linspace(a, b, 21) for a, b in zip(low, high, strict=True))
        grid = np.stack([*np.meshgrid(x, y, indexing="ij"), np.zeros((21, 21))], axis=-1)
        points = bend_points(scene, grid, bend)
        way = sum(
            np.linalg.norm(points - bend_points(scene, end, bend), axis=-1)
            for end in (source, target)
        )
        best = grid.reshape(-1, 3)[way.argmin()]
        size = (high - low) / 5
        low, high = best[:2] - size / 2, best[:2] + size / 2
    return best


@pytest.mark.parametrize("bend", BENDS)
def test_a_straight_way_joins_the_points_in_the_world(scene: Scene, bend: float) -> None:
    for target in TARGETS:
        path = direct_path(SOURCE, target, 4.0, curvature(scene, bend))
        way = bend_points(scene, target, bend) - bend_points(scene, SOURCE, bend)
        unit = way / np.linalg.norm(way)
        np.testing.assert_allclose(world(scene, SOURCE, path.depart, bend), unit, atol=1e-6)
        np.testing.assert_allclose(world(scene, target, path.arrive, bend), -unit, atol=1e-6)
        if path.spread > 0:
            assert path.spread == pytest.approx(1 / (way @ way), rel=1e-6)


@pytest.mark.parametrize("bend", BENDS)
def test_the_mirrored_way_is_the_shortest_by_the_lower_face(scene: Scene, bend: float) -> None:
    for target in TARGETS[:3]:
        path = mirrored_path(SOURCE, target, 4.0, curvature(scene, bend))
        turn = bend_points(scene, reflection(scene, SOURCE, target, bend), bend)
        for end, local in ((SOURCE, path.depart), (target, path.arrive)):
            way = turn - bend_points(scene, end, bend)
            unit = way / np.linalg.norm(way)
            np.testing.assert_allclose(world(scene, end, local, bend), unit, atol=1e-4)


@pytest.mark.parametrize("bend", [0.4, np.pi / 2])
def test_the_mirrored_spread_is_that_of_a_traced_tube_of_rays(scene: Scene, bend: float) -> None:
    kappa = curvature(scene, bend)
    radius = 1 / kappa
    axis = np.array([scene.camera.y, scene.pad.thickness + radius])
    for target in TARGETS[:3]:
        path = mirrored_path(SOURCE, target, 4.0, kappa)
        start = bend_points(scene, SOURCE, bend)
        middle = world(scene, SOURCE, path.depart, bend)
        side = np.cross(middle, [0.3, 0.5, 0.7])
        side /= np.linalg.norm(side)
        step = 1e-4
        rays = [middle, middle + step * side, middle + step * np.cross(middle, side)]
        facing = -world(scene, target, path.arrive, bend)
        hits = []
        for ray in (vector / np.linalg.norm(vector) for vector in rays):
            to_axis, along = start[1:] - axis, ray[1:]
            a, b = along @ along, to_axis @ along
            c = to_axis @ to_axis - (radius + 4.0) ** 2
            point = start + ray * (np.sqrt(b * b - a * c) - b) / a
            normal = np.concatenate([[0.0], point[1:] - axis])
            normal /= np.linalg.norm(normal)
            bounced = ray - 2 * (ray @ normal) * normal
            plane = bend_points(scene, target, bend)
            hits.append(point + bounced * ((plane - point) @ facing) / (bounced @ facing))
        np.testing.assert_allclose(hits[0], bend_points(scene, target, bend), atol=1e-4)
        area = np.linalg.norm(np.cross(hits[1] - hits[0], hits[2] - hits[0]))
        assert path.spread == pytest.approx(step**2 / area, rel=2e-3)


def test_the_flat_mirror_is_the_limit_of_the_arc() -> None:
    flat = mirrored_path(SOURCE, TARGETS, 4.0, 0.0)
    way = TARGETS - SOURCE * [1, 1, -1]
    np.testing.assert_allclose(flat.spread, 1 / (way**2).sum(axis=-1), rtol=1e-6)
    np.testing.assert_allclose(flat.cosine, way[:, 2] / np.linalg.norm(way, axis=-1), rtol=1e-6)


def hidden(scene: Scene, source: np.ndarray, target: np.ndarray, bend: float) -> bool:
    """Return whether the straight way leaves the pad through the coating."""
    ends = [bend_points(scene, end, bend) for end in (source, target)]
    line = ends[0] + np.linspace(0.001, 0.999, 2001)[:, None] * (ends[1] - ends[0])
    axis = np.array([scene.camera.y, scene.pad.thickness + 1 / curvature(scene, bend)])
    return bool((np.linalg.norm(line[:, 1:] - axis, axis=1) < 1 / curvature(scene, bend)).any())


def test_the_coating_hides_what_lies_behind_its_horizon(scene: Scene) -> None:
    rng = np.random.default_rng(4)
    source = rng.uniform([-9, -15, 0.1], [9, 15, 3.9], (300, 3))
    target = rng.uniform([-9, -15, 3.0], [9, 15, 4.0], (300, 3))
    for bend in (0.3, np.pi / 2, np.pi):
        spread = direct_path(source, target, 4.0, curvature(scene, bend)).spread
        expected = [hidden(scene, s, t, bend) for s, t in zip(source, target, strict=True)]
        np.testing.assert_array_equal(spread == 0, expected)
        assert 10 < sum(expected) < 290


@pytest.mark.parametrize("turns", [(1, 0), (-2, 0), (0, 3), (1, -1), (-1, 2)])
def test_light_meets_edges_where_steps_along_its_folded_way_stay_below_the_skin(
    turns: tuple[int, int],
) -> None:
    scene = scene_of_case("dome")
    rng, skin = np.random.default_rng(sum(turns) + 7), scene.skin
    assert skin is not None
    size = scene.box.high - scene.box.low
    low, high = scene.box.low, scene.box.high
    target = rng.uniform(low, high, (200, 3)) * [1, 1, 0.9]
    inside = scene.pad.thickness + skin.rise(target[:, 0], target[:, 1]) > target[:, 2]
    target = target[inside]
    source = wall_image(scene, turns).image(target[::-1])
    source[::2, 2] *= -1
    part = np.linspace(0.0, 1.0, 4001)[1:-1, None, None]
    way = target + part * (source - target)
    turned = (way[..., :2] - low[:2]) % (2 * size[:2])
    folded = low[:2] + np.minimum(turned, 2 * size[:2] - turned)
    room = scene.pad.thickness + skin.rise(folded[..., 0], folded[..., 1]) - np.abs(way[..., 2])
    met = meets_edges(scene, source, target, turns)
    clear = np.abs(room.min(axis=0)) > 0.02
    assert 0 < met[clear].sum() < clear.sum()
    np.testing.assert_array_equal(met[clear] > 0, room.min(axis=0)[clear] > 0)
