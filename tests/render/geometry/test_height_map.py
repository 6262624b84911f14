"""Skin as a height map: closed forms of what is pressed in, and what smoothing may change."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from render.errors import SceneError
from render.geometry import HeightMap, imprint_depth, probe, straight_edge, unbend_points
from render.geometry.height_map import STEP
from render.geometry.mesh_probe import body_of_file
from render.geometry.meshes import imprinted_coating
from render.geometry.probes import BALL_RADIUS
from render.scene import Scene, load_scene


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("finger20")


def ball_file(folder: Path, radius: float) -> Path:
    trimesh.creation.icosphere(subdivisions=5, radius=radius).export(folder / "ball.stl")
    return folder / "ball.stl"


def middle(skin: HeightMap) -> tuple[float, float]:
    low_x, low_y, high_x, high_y = skin.bounds
    return 0.5 * (low_x + high_x), 0.5 * (low_y + high_y)


@pytest.mark.parametrize(("radius", "depth"), [(3.0, 0.3), (3.0, 1.0), (1.5, 0.7)])
def test_a_ball_has_the_contact_circle_and_the_volume_of_its_cap(
    scene: Scene, tmp_path: Path, radius: float, depth: float
) -> None:
    skin = body_of_file(scene, ball_file(tmp_path, radius), depth)
    area = (skin.depth > 0).sum() * np.prod(skin.step)
    circle = np.sqrt(2 * radius * depth - depth**2)
    assert np.sqrt(area / np.pi) == pytest.approx(circle, abs=0.01 * radius)
    volume = skin.depth.sum() * np.prod(skin.step)
    assert volume == pytest.approx(np.pi * depth**2 * (radius - depth / 3), rel=0.01)
    assert skin.deepest == pytest.approx(depth, abs=0.002 * radius)
    x, y = middle(skin)
    away = np.linspace(0.0, 0.9 * circle, 20)
    cap = np.sqrt(radius**2 - away**2) - (radius - depth)
    np.testing.assert_allclose(skin.at(x + away, np.full(20, y)), cap, atol=0.005)


def test_hollows_of_a_file_stay_hollow_and_y_is_towards_the_tip(
    scene: Scene, tmp_path: Path
) -> None:
    ring = trimesh.creation.annulus(r_min=1.5, r_max=3.0, height=4.0)
    post = trimesh.creation.box((0.5, 0.5, 4.0)).apply_translation((0.0, 2.25, -0.4))
    trimesh.util.concatenate([ring, post]).export(tmp_path / "ring.ply")
    skin = body_of_file(scene, tmp_path / "ring.ply", 0.9)
    x, y = middle(skin)
    found = skin.at(x + np.array([0.0, 2.25, -2.25, 0.0, 0.0]), y + np.array([0, 0, 0, -2.25, 2.2]))
    np.testing.assert_allclose(found, [0.0, 0.5, 0.5, 0.5, 0.9], atol=1e-6)


def test_smoothed_skin_is_never_inside_the_body_and_touches_it_where_it_is_wide(
    scene: Scene, tmp_path: Path
) -> None:
    trimesh.creation.box((6.0, 4.0, 2.0)).export(tmp_path / "box.stl")
    body = body_of_file(scene, tmp_path / "box.stl", 0.8)
    volumes = [body.depth.sum()]
    for length in (0.1, 0.3, 0.6):
        skin = body.smoothed(length)
        assert (skin.depth >= body.depth).all()
        assert skin.deepest == body.deepest
        np.testing.assert_array_equal(skin.depth[body.depth > 0], 0.8)
        x, y = middle(skin)
        steps = np.linspace(0.0, 5.0, 101)
        across = skin.at(x + steps, np.full(101, y))
        assert (np.diff(across) <= 1e-12).all()
        assert np.abs(np.diff(across)).max() < (0.8 if length < STEP else 0.5)
        volumes.append(skin.depth.sum())
    assert (np.diff(volumes) > 0).all()
    assert volumes[1] == pytest.approx(volumes[0], rel=0.2)


def test_one_gaussian_over_a_wall_is_the_error_function_and_more_only_deepen_it() -> None:
    from scipy.special import erfc

    x = np.linspace(-5.0, 5.0, 201)
    wall = HeightMap(np.tile(np.where(np.abs(x) <= 2.0, 1.0, 0.0), (201, 1)), 10.0, 10.0)
    # Away from the ends of the wall, which the pad's edges hold.
    inner = HeightMap(np.where(np.abs(x)[:, None] < 3.0, wall.depth, 0.0), 10.0, 10.0)
    away = np.array([0.2, 0.4, 0.8])
    first = 0.5 * erfc((away - 0.025) / (0.4 * np.sqrt(2)))
    found = inner.smoothed(0.4).at(2.0 + away, np.zeros(3))
    assert (found >= first - 1e-3).all()
    np.testing.assert_allclose(found[2], first[2], atol=0.03)


def test_a_deeper_body_makes_deeper_skin_everywhere(scene: Scene) -> None:
    skins = [probe(scene, "ball", depth, 0.4) for depth in (0.5, 0.8)]
    assert all(isinstance(skin, HeightMap) for skin in skins)
    shallow, deep = (skin.depth for skin in skins if isinstance(skin, HeightMap))
    assert (deep >= shallow).all()
    # The skin leaves the ball inside of the circle that the rigid shapes have in common.
    x, y = np.meshgrid(np.linspace(-9, 9, deep.shape[1]), np.linspace(-15, 15, deep.shape[0]))
    away = np.hypot(x, y - 3.0)
    cap = np.sqrt(np.maximum(BALL_RADIUS**2 - away**2, 0.0)) - (BALL_RADIUS - 0.8)
    touching = away[(deep - cap < 1e-9) & (cap > 0)].max()
    assert 0.5 < touching < np.sqrt(2 * BALL_RADIUS * 0.8 - 0.8**2)


def test_smooth_skin_keeps_the_line_of_an_edge(scene: Scene) -> None:
    skin, rigid = probe(scene, "edge", 0.8, 0.2), straight_edge(scene, 0.8)
    assert isinstance(skin, HeightMap)
    x, y, _ = rigid.center[0]
    along = np.linspace(-3.8, 3.8, 20)
    np.testing.assert_allclose(skin.at(x + along, np.full(20, y)), 0.8, atol=1e-9)


@pytest.mark.parametrize("bend", [0.0, np.pi / 2])
def test_the_mesh_of_level_2_is_the_height_map(scene: Scene, bend: float) -> None:
    skin = probe(scene, "bolt", 0.7, 0.3)
    assert isinstance(skin, HeightMap)
    mesh = imprinted_coating(scene, bend, skin)
    flat = unbend_points(scene, mesh.vertices, bend)
    inner = (np.abs(flat[:, 0]) < 8.9) & (np.abs(flat[:, 1]) < 14.9)
    depth = imprint_depth(skin, flat[inner, 0], flat[inner, 1])
    np.testing.assert_allclose(scene.pad.thickness - flat[inner, 2], depth, atol=1e-7)
    assert depth.max() == pytest.approx(0.7)


@pytest.mark.parametrize(
    ("size", "depth", "said"),
    [
        ((16.5, 9.0, 2.0), 1.0, "smooth = 2 mm moves the skin at the pad's edge by 0.1"),
        ((40.0, 2.0, 2.0), None, "does not fit into the pad"),
        ((4.0, 2.0, 0.5), 0.8, "0.5 mm high, allowed: up to that"),
        (None, None, "is no body"),
    ],
)
def test_a_file_that_cannot_be_pressed_in_raises_one_clear_error(
    scene: Scene,
    tmp_path: Path,
    size: tuple[float, float, float] | None,
    depth: float | None,
    said: str,
) -> None:
    path = tmp_path / "body.stl"
    if size is None:
        path.write_text("solid nothing")
    else:
        trimesh.creation.box(size).export(path)
    with pytest.raises(SceneError, match=said):
        body_of_file(scene, path, depth, smoothing=2.0)


@pytest.mark.parametrize("corner", [(3.0, 0.0, 2.0), (0.01, 0.0, 2.0)])
def test_a_file_without_an_area_seen_from_below_raises_one_clear_error(
    scene: Scene, tmp_path: Path, corner: tuple[float, float, float]
) -> None:
    """An upright triangle, and another that falls between the places of the skin."""
    points = [[0.0, 0.0, 0.0], corner, [corner[0], 1e-4 * (corner[0] < 1.0), 1.0]]
    trimesh.Trimesh(points, [[0, 1, 2]], process=False).export(tmp_path / "blade.stl")
    with pytest.raises(SceneError, match=r"has no area seen from below, at places 0\.\d+ mm apart"):
        body_of_file(scene, tmp_path / "blade.stl", 0.5)


def test_an_open_shell_presses_as_the_closed_body_of_the_same_lower_side(
    scene: Scene, tmp_path: Path
) -> None:
    box = trimesh.creation.box((4.0, 3.0, 2.0))
    closed = box.copy()
    box.update_faces(box.face_normals[:, 2] < 0.5)
    assert not box.is_watertight
    depths = []
    for body in (closed, box):
        body.export(tmp_path / "box.stl")
        depths.append(body_of_file(scene, tmp_path / "box.stl", 0.5).depth)
    np.testing.assert_array_equal(depths[0], depths[1])
