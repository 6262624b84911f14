"""The camera at any pose, pinhole or fisheye: its rays, their inverse, and Mitsuba's own."""

from __future__ import annotations

from types import ModuleType

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from render.geometry import (
    camera_is_symmetric,
    camera_rays,
    facet_masks,
    pixel_directions,
    pixel_positions,
)
from render.scene import Camera, Scene, load_scene, unchecked

FINGER = load_scene("finger20")
FLAT = unchecked(
    FINGER, {"bending": unchecked(FINGER.bending, {"angles": (0.0,)}), "diffuser": None}
)


def with_camera(scene: Scene = FLAT, **values: object) -> Scene:
    old = {"field_of_view": np.radians(110.0), "columns": 90, "rows": 150}
    return unchecked(scene, {"camera": Camera.model_construct(**(old | values))})


ASKEW = {"position": (4.0, -9.0, -12.0), "look_at": (1.0, 2.0, 4.0), "up": (0.3, 1.0, 0.2)}
LENSES = ["pinhole", "fisheye"]


def expected_direction(camera: Camera, column: float, row: float) -> np.ndarray:
    """Rotate the axis of the lens by hand: about the image's normal direction, by the angle."""
    ahead = np.subtract(camera.look_at, camera.position)
    ahead = ahead / np.linalg.norm(ahead)
    up = np.array(camera.up) - ahead * (ahead @ np.array(camera.up))
    up /= np.linalg.norm(up)
    # In pixels from the middle, right and up.
    x, y = column - camera.columns / 2, camera.rows / 2 - row
    radius = np.hypot(x, y)
    half = camera.field_of_view / 2
    if camera.lens == "fisheye":
        angle = half * radius / (camera.rows / 2)
    else:
        angle = np.arctan(np.tan(half) * radius / (camera.rows / 2))
    right = np.cross(ahead, up)
    towards = (x * right + y * up) / radius
    turn = Rotation.from_rotvec(angle * np.cross(ahead, towards))
    return np.asarray(turn.apply(ahead))


@pytest.mark.parametrize("lens", LENSES)
def test_rays_of_a_turned_camera_are_its_axis_turned_by_the_angle_of_the_lens(lens: str) -> None:
    scene = with_camera(**ASKEW, lens=lens)
    for column, row in [(0.0, 0.0), (90.0, 75.0), (45.0, 3.0), (20.5, 140.5), (89.0, 0.5)]:
        found = pixel_directions(scene, 90, 150, np.array([column]), np.array([row]))[0]
        np.testing.assert_allclose(found, expected_direction(scene.camera, column, row), atol=1e-12)


@pytest.mark.parametrize("lens", LENSES)
def test_positions_are_the_inverse_of_directions_also_far_off_the_axis(lens: str) -> None:
    angle = 172.0 if lens == "pinhole" else 240.0
    scene = with_camera(**ASKEW, lens=lens, field_of_view=np.radians(angle))
    column, row = np.array([0.1, 45.0, 45.0, 88.0]), np.array([149.0, 75.0, 75.001, 2.0])
    directions = pixel_directions(scene, 90, 150, column, row)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0, atol=1e-12)
    found = pixel_positions(scene, 90, 150, directions)
    np.testing.assert_allclose(found, np.stack([column, row], axis=-1), atol=1e-6)


def test_a_pinhole_has_no_image_of_what_lies_behind_it() -> None:
    scene = with_camera(**ASKEW)
    behind = np.subtract(ASKEW["position"], ASKEW["look_at"])[None]
    assert np.isnan(pixel_positions(scene, 90, 150, behind)).all()


def test_the_same_pose_in_other_words_has_the_same_rays() -> None:
    old = with_camera(distance=10.0, y=3.0)
    for words in (
        {"position": (0.0, 3.0, -10.0)},
        {"distance": 10.0, "y": 3.0, "direction": (0.0, 0.0, 2.0), "up": (0.0, 5.0, 1.0)},
        {"position": (0.0, 3.0, -10.0), "look_at": (0.0, 3.0, 4.0), "lens": "pinhole"},
    ):
        new = with_camera(**words)
        assert new.hash == old.hash
        for a, b in zip(camera_rays(new, 9, 15), camera_rays(old, 9, 15), strict=True):
            np.testing.assert_array_equal(a, b)


def test_a_camera_turned_by_half_a_turn_sees_the_turned_picture() -> None:
    straight = with_camera(position=(1.0, 3.0, -10.0))
    turned = with_camera(position=(1.0, 3.0, -10.0), up=(0.0, -1.0, 0.0))
    first, second = (facet_masks(scene, 0.0) for scene in (straight, turned))
    np.testing.assert_array_equal(first.counts, second.counts)
    for site in (0, 7, 14):
        for facet in (0, 4, 10):
            ours = 90 * 150 - 1 - first.of(site, facet)[::-1]
            np.testing.assert_array_equal(ours, second.of(site, facet))


def test_a_quarter_turn_of_the_camera_exchanges_rows_and_columns() -> None:
    wide = np.radians(2 * np.degrees(np.arctan(np.tan(np.radians(55.0)) * 90 / 150)))
    straight = with_camera(position=(0.0, 3.0, -10.0))
    turned = with_camera(
        position=(0.0, 3.0, -10.0), up=(1.0, 0.0, 0.0), columns=150, rows=90, field_of_view=wide
    )
    first, second = (facet_masks(scene, 0.0) for scene in (straight, turned))
    np.testing.assert_array_equal(first.counts, second.counts)
    pixel = first.of(7, 3)
    row, column = pixel // 90, pixel % 90
    # Up is +x, so what was left (+x) is up, and what was up is right.
    found = second.of(7, 3)
    there = np.sort(column * 150 + (149 - row))
    np.testing.assert_array_equal(there, found)


def test_moving_the_camera_is_moving_the_scene_the_other_way() -> None:
    moved = with_camera(position=(1.5, 2.0, -12.0), look_at=(-1.0, 4.0, 4.0))
    sites = unchecked(moved.sites, {"centre_x": 0.5, "centre_y": 2.5})
    pad = unchecked(moved.pad, {"width": 60.0, "length": 60.0})
    here = unchecked(moved, {"pad": pad})
    there = with_camera(position=(2.0, 1.5, -12.0), look_at=(-0.5, 3.5, 4.0))
    there = unchecked(there, {"sites": sites, "pad": pad})
    a, b = facet_masks(here, 0.0), facet_masks(there, 0.0)
    np.testing.assert_array_equal(a.counts, b.counts)
    np.testing.assert_array_equal(a.pixel, b.pixel)


def test_only_a_camera_in_the_middle_that_looks_along_it_has_a_mirror() -> None:
    straight = {"position": (0.0, -5.0, -10.0)}
    assert camera_is_symmetric(FINGER)
    assert camera_is_symmetric(with_camera(**straight, direction=(0.0, 1.0, 2.0)))
    assert camera_is_symmetric(with_camera(**straight, up=(1.0, 0.0, 0.0)))
    assert not camera_is_symmetric(with_camera(**straight, up=(1.0, 1.0, 0.0)))
    assert not camera_is_symmetric(with_camera(**straight, direction=(0.1, 1.0, 2.0)))
    assert not camera_is_symmetric(with_camera(position=(1.0, 3.0, -10.0)))


@pytest.mark.parametrize("lens", LENSES)
def test_rays_are_those_of_the_mitsuba_sensor_and_of_the_cells(mono: ModuleType, lens: str) -> None:
    from render.cells.cell_sampler import pixel_rays
    from render.optics.lit_scene import camera_sensor

    scene = with_camera(**ASKEW, lens=lens)
    column, row = np.array([0.25, 44.0, 89.5, 60.0]), np.array([0.75, 80.0, 10.5, 149.0])
    wanted = pixel_directions(scene, 90, 150, column, row)
    sensor = mono.load_dict(camera_sensor(scene, 90, 150))
    where = mono.Point2f((column / 90).astype(np.float32), (row / 150).astype(np.float32))
    ray, weight = sensor.sample_ray(mono.Float(0.0), mono.Float(0.5), where, mono.Point2f(0.5))
    np.testing.assert_allclose(np.array(ray.d).T, wanted, atol=2e-6)
    np.testing.assert_allclose(np.array(weight), 1.0)
    near = np.linalg.norm(np.array(ray.o).T - ASKEW["position"], axis=1)
    assert near.max() < 0.05
    image = (mono.Float(column.astype(np.float32)), mono.Float(row.astype(np.float32)))
    origin, direction = pixel_rays(scene, *image, 90, 150)
    np.testing.assert_allclose(np.array(direction).T, wanted, atol=2e-6)
    np.testing.assert_allclose(np.array(origin).T[0], ASKEW["position"], atol=1e-6)
