"""Pad positions and pixels are each other's inverse, at any bend."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hw.camera.projection import pad_positions, pixels_of, rotation
from hw.check.prediction import RADIUS, SiteSpots
from render.geometry import facet_masks, flat_sites
from render.scene import load_scene, unchecked
from tests.oracles.pads import scene_of_case

SCENE = load_scene("finger20")
ROWS, COLUMNS = 120, 72
TILT = (0.1, -0.2, 0.3)


@pytest.mark.parametrize("bend", [0.0, 45.0, 90.0])
def test_a_pixel_looks_at_the_point_that_it_was_found_for(bend: float) -> None:
    angle = np.radians(bend)
    flat = pad_positions(SCENE, angle, ROWS, COLUMNS)
    row, column = 60, np.array([20, 36, 50])
    points = flat[row, column]
    assert np.isfinite(points).all()
    found = pixels_of(SCENE, angle, points, ROWS, COLUMNS)
    np.testing.assert_allclose(
        found, np.stack([column + 0.5, np.full(3, row + 0.5)], -1), atol=0.02
    )


def test_the_tip_is_up_and_columns_run_against_x() -> None:
    flat = pad_positions(SCENE, 0.0, ROWS, COLUMNS)
    assert flat[40, 36, 1] > flat[80, 36, 1]
    assert flat[60, 20, 0] > flat[60, 50, 0]


def test_what_the_camera_cannot_see_is_nan() -> None:
    found = pixels_of(SCENE, 0.0, np.array([[0.0, -14.9], [50.0, 0.0]]), ROWS, COLUMNS)
    assert np.isnan(found).all()


@pytest.mark.parametrize("bend", [0.0, 90.0])
def test_spots_lie_about_the_renderers_own(bend: float) -> None:
    angle = np.radians(bend)
    spots = SiteSpots(SCENE, angle)
    masks = facet_masks(SCENE, angle)
    seen = np.zeros(SCENE.camera.rows * SCENE.camera.columns)
    for site in range(SCENE.sites.count):
        seen[:] = 0.0
        seen[masks.of(site, masks.facets)] = 1.0
        photo = np.repeat(seen.reshape(SCENE.camera.rows, SCENE.camera.columns, 1), 3, 2)
        inside = spots.colors(photo)[:, 0] * spots.counts
        # All pixels of the site's own spot lie in ours, and in no other site's.
        assert inside[site] == pytest.approx(seen.sum())
        assert np.delete(inside, site).sum() == 0


def test_spots_are_discs_of_their_radius() -> None:
    flat = pad_positions(SCENE, 0.0, SCENE.camera.rows, SCENE.camera.columns)
    site = flat_sites(SCENE)[7, :2]
    near = np.hypot(*(flat - site).reshape(-1, 2).T) <= RADIUS
    assert SiteSpots(SCENE, 0.0).counts[7] == near.sum()


def test_turns_are_right_handed_about_x_and_z_and_left_handed_about_y() -> None:
    about_x, about_y, about_z = TILT
    wanted = Rotation.from_euler("xyz", [about_x, -about_y, about_z]).as_matrix()
    np.testing.assert_allclose(rotation(TILT), wanted, atol=1e-15)


@pytest.mark.parametrize("axis", [0, 1])
def test_a_tilt_leads_the_optical_axis_sideways_by_its_own_angle(axis: int) -> None:
    ahead = rotation(np.eye(3)[axis] * 0.1) @ [0.0, 0.0, 1.0]
    sideways = -np.sin(0.1) * np.eye(3)[1 - axis]
    np.testing.assert_allclose(ahead, [*sideways[:2], np.cos(0.1)], atol=1e-15)


def test_turning_back_is_the_inverse() -> None:
    turn = rotation(TILT)
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)


def test_pixels_look_at_a_dome_as_rays_do() -> None:
    dome = scene_of_case("dome")
    flat = pad_positions(dome, 0.0, ROWS, COLUMNS)
    row, column = 60, np.array([20, 36, 50])
    points = flat[row, column]
    assert np.isfinite(points).all()
    found = pixels_of(dome, 0.0, points, ROWS, COLUMNS)
    np.testing.assert_allclose(
        found, np.stack([column + 0.5, np.full(3, row + 0.5)], -1), atol=0.02
    )
    # The skin falls away from its crown, towards the camera: it is seen farther out.
    level = pad_positions(unchecked(dome, {"skin": None}), 0.0, ROWS, COLUMNS)
    assert np.abs(level[60, 20, 0]) > np.abs(flat[60, 20, 0])
