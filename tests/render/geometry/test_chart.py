"""The chart of the skin: frames are its slopes, coordinates come back, rays find it."""

from __future__ import annotations

import numpy as np
import pytest

from render.geometry import SkinChart
from render.scene import SHAPES, Scene, load_scene
from tests.oracles.pads import SKINS, scene_of_case

FINGER = load_scene("finger20")
CURVED = [scene_of_case(case) for case in SKINS.values()]
CASES = [(FINGER, 0.0), (FINGER, 1e-6), (FINGER, 1.2), *((scene, 0.0) for scene in CURVED)]
RNG = np.random.default_rng(3)


def test_every_shape_is_tried() -> None:
    assert set(SKINS) == set(SHAPES)


def uv_of(scene: Scene, count: int = 300) -> np.ndarray:
    half = np.array([scene.pad.width, scene.pad.length]) / 2
    return RNG.uniform(-0.97 * half, 0.97 * half, (count, 2))


@pytest.mark.parametrize(("scene", "bend"), CASES)
def test_coordinates_come_back(scene: Scene, bend: float) -> None:
    chart, uv = SkinChart(scene, bend), uv_of(scene)
    np.testing.assert_allclose(chart.uv(chart.points(uv)), uv, atol=1e-9)


@pytest.mark.parametrize(("scene", "bend"), CASES)
def test_frames_are_rotations_and_their_first_two_axes_lie_in_the_skin(
    scene: Scene, bend: float
) -> None:
    chart, uv = SkinChart(scene, bend), uv_of(scene)
    turn = chart.frames(uv)
    np.testing.assert_allclose(np.swapaxes(turn, -1, -2) @ turn, [np.eye(3)] * len(uv), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(turn), 1.0, atol=1e-12)
    for step in np.eye(2) * 1e-5:
        along = (chart.points(uv + step) - chart.points(uv - step)) / 2e-5
        out = np.einsum("nij,ni->nj", turn, along)
        np.testing.assert_allclose(out[:, 2], 0.0, atol=1e-8)
        # Towards +x and the tip, not away from them.
        assert (out[:, :2] @ step > 0).all()
    assert (turn[:, 2, 2] > 0).all()


@pytest.mark.parametrize(("scene", "bend"), CASES)
def test_rays_from_below_meet_the_skin_where_they_were_aimed(scene: Scene, bend: float) -> None:
    chart, uv = SkinChart(scene, bend), uv_of(scene)
    goal, inward = chart.points(uv), -chart.frames(uv)[..., 2]
    aside = RNG.normal(0.0, 0.2, (len(uv), 3))
    start = goal + inward + aside
    direction = goal - start
    length = np.linalg.norm(direction, axis=1)
    way = chart.way(start, direction / length[:, None])
    np.testing.assert_allclose(way, length, atol=1e-6)


def test_rays_that_look_away_from_the_skin_pass_it() -> None:
    down = np.array([[0.0, 0.3, -1.0]]) / np.hypot(0.3, 1.0)
    for scene, bend in CASES:
        assert SkinChart(scene, bend).way(np.array([[0.0, 0.0, 2.0]]), down)[0] == np.inf
