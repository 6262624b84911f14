"""Bending keeps the coating's length and is exact and stable down to no bend at all."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from render.geometry import bend_frames, bend_points, curvature, unbend_points
from render.scene import load_scene

SCENE = load_scene("finger20")
RNG = np.random.default_rng(1)
POINTS = RNG.uniform([-11, -15, 0], [11, 17, 4], (500, 3))
BENDS = [0.0, 1e-12, 1e-6, 0.3, np.pi / 2, np.pi]

coordinates = st.tuples(
    st.floats(-11, 11), st.floats(-15, 17), st.floats(0, 4), st.floats(0, np.pi)
)


def test_no_bend_changes_nothing() -> None:
    np.testing.assert_array_equal(bend_points(SCENE, POINTS, 0.0), POINTS)
    np.testing.assert_array_equal(bend_frames(SCENE, POINTS[:, 1], 0.0), [np.eye(3)] * 500)


def test_a_tiny_bend_differs_by_its_first_order_only() -> None:
    tiny = 1e-6
    u, w = POINTS[:, 1] - SCENE.camera.y, SCENE.pad.thickness - POINTS[:, 2]
    kappa = tiny / SCENE.pad.length
    first_order = POINTS + kappa * np.stack([0 * u, u * w, 0.5 * u**2], axis=-1)
    np.testing.assert_allclose(bend_points(SCENE, POINTS, tiny), first_order, atol=1e-11)


@pytest.mark.parametrize("bend", BENDS)
def test_the_coating_keeps_its_length(bend: float) -> None:
    y = np.linspace(-15, 15, 20001)
    line = bend_points(SCENE, np.stack([0 * y, y, 0 * y + 4.0], axis=-1), bend)
    assert np.linalg.norm(np.diff(line, axis=0), axis=1).sum() == pytest.approx(30.0, rel=1e-8)


@pytest.mark.parametrize("bend", BENDS)
def test_thickness_and_width_are_kept(bend: float) -> None:
    below, above = POINTS * [1, 1, 0], POINTS * [1, 1, 0] + [0, 0, 4]
    thickness = bend_points(SCENE, above, bend) - bend_points(SCENE, below, bend)
    np.testing.assert_allclose(np.linalg.norm(thickness, axis=1), 4.0, rtol=1e-12)
    np.testing.assert_array_equal(bend_points(SCENE, POINTS, bend)[:, 0], POINTS[:, 0])


@pytest.mark.parametrize("bend", BENDS[3:])
def test_the_coating_is_an_arc_of_the_total_angle(bend: float) -> None:
    radius = 1 / curvature(SCENE, bend)
    y = np.linspace(-15, 15, 50)
    arc = bend_points(SCENE, np.stack([0 * y, y, 0 * y + 4.0], axis=-1), bend)
    center = np.array([0.0, SCENE.camera.y, 4.0 + radius])
    np.testing.assert_allclose(np.linalg.norm(arc - center, axis=1), radius)
    ends = bend_frames(SCENE, y[[0, -1]], bend)[:, :, 1]
    assert np.arccos(ends[0] @ ends[1]) == pytest.approx(bend)


def test_the_pad_above_the_camera_stays_and_the_rest_rolls_away() -> None:
    above = np.array([[2.0, SCENE.camera.y, 1.5]])
    np.testing.assert_allclose(bend_points(SCENE, above, 1.2), above, atol=1e-12)
    far = np.array([[0.0, -15.0, 4.0], [0.0, 15.0, 4.0]])
    assert (bend_points(SCENE, far, 1.2)[:, 2] > 4.5).all()


@pytest.mark.parametrize("bend", BENDS)
def test_frames_are_rotations_tangent_to_the_arc(bend: float) -> None:
    turn = bend_frames(SCENE, POINTS[:, 1], bend)
    np.testing.assert_allclose(
        turn @ turn.swapaxes(1, 2), np.broadcast_to(np.eye(3), turn.shape), atol=1e-14
    )
    np.testing.assert_allclose(np.linalg.det(turn), 1.0)
    step = 1e-6
    coating = POINTS * [1, 1, 0] + [0, 0, 4]
    ahead = bend_points(SCENE, coating + [0, step, 0], bend)
    behind = bend_points(SCENE, coating - [0, step, 0], bend)
    np.testing.assert_allclose((ahead - behind) / (2 * step), turn[:, :, 1], atol=1e-8)


@pytest.mark.parametrize("bend", BENDS)
def test_unbending_undoes_bending(bend: float) -> None:
    back = unbend_points(SCENE, bend_points(SCENE, POINTS, bend), bend)
    np.testing.assert_allclose(back, POINTS, atol=1e-12)


@given(coordinates)
def test_unbending_undoes_bending_anywhere(place: tuple[float, float, float, float]) -> None:
    point, bend = np.array(place[:3]), place[3]
    back = unbend_points(SCENE, bend_points(SCENE, point, bend), bend)
    np.testing.assert_allclose(back, point, atol=1e-11)
