"""What is pressed into the pad: closed convex bodies, and a bolt that shows in pictures."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import trimesh

import render.preview.lights
from render.errors import GraphicsError, SceneError
from render.geometry import (
    BoltHead,
    Imprint,
    ball,
    bolt,
    fiber_edges,
    flat_sites,
    imprint_depth,
    pyramid,
    pyramids,
    smoothed_skin,
    straight_edge,
    unbend_points,
)
from render.geometry.height_map import map_lines
from render.geometry.mesh_probe import body_of_file
from render.geometry.meshes import imprinted_coating, pad_meshes
from render.preview import Preview
from render.scene import Scene, load_scene, unchecked
from tests.oracles.pads import scene_of_case


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("finger20")


@pytest.fixture(scope="module")
def pressed(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Preview]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(render.preview.lights, "RAYS", 20_000)
        cache = tmp_path_factory.mktemp("slab")
        with Preview(scene, cache=cache, imprint=bolt(scene)) as preview:
            yield preview


def outside(body: Imprint, points: np.ndarray) -> np.ndarray:
    """Return how far points ``(n, 3)`` lie outside of the body's faces, ``(n, face)`` mm."""
    return np.asarray(points @ body.normal.T - body.distance)


@pytest.mark.parametrize("make", [pyramids, bolt, ball, straight_edge])
def test_every_face_is_one_of_a_convex_body(scene: Scene, make: object) -> None:
    body: Imprint = make(scene)  # type: ignore[operator]
    np.testing.assert_allclose(np.linalg.norm(body.normal, axis=1), 1.0)
    away = outside(body, body.middle)
    np.testing.assert_allclose(np.diag(away), 0.0, atol=1e-12)
    assert (away < 1e-9).all()
    assert (body.normal[:, 2] < 0).all()


def test_a_ball_is_a_ball(scene: Scene) -> None:
    body = ball(scene, radius=3.0, depth=1.0)
    x, y, _ = body.center[0]
    away = np.linspace(0.0, 4.0, 81)
    cap = np.maximum(np.sqrt(np.maximum(9.0 - away**2, 0.0)) - 2.0, 0.0)
    np.testing.assert_allclose(imprint_depth(body, x + away, y), cap, atol=0.05)
    np.testing.assert_allclose(imprint_depth(body, x, y - away), cap, atol=0.05)


def test_an_edge_is_two_planes_that_meet_in_a_line_across(scene: Scene) -> None:
    body = straight_edge(scene, depth=0.8)
    x, y, _ = body.center[0]
    along, away = np.linspace(-4.0, 4.0, 33), np.linspace(-1.5, 1.5, 61)
    np.testing.assert_allclose(imprint_depth(body, x + along, y), 0.8, atol=1e-12)
    np.testing.assert_allclose(
        imprint_depth(body, x, y + away), np.maximum(0.8 - np.abs(away), 0.0), atol=1e-12
    )
    ends = 4.0 + 0.8 / np.tan(np.pi / 3) * np.array([0.5, 1.0, 1.1])
    np.testing.assert_allclose(imprint_depth(body, x - ends, y), [0.4, 0.0, 0.0], atol=1e-12)


@pytest.mark.parametrize("bend", [0.0, np.pi / 4])
def test_the_mesh_of_an_imprint_is_the_coating_with_the_body_in_it(
    scene: Scene, bend: float
) -> None:
    body = bolt(scene)
    found, plain = imprinted_coating(scene, bend, body), pad_meshes(scene, bend, False).coating
    np.testing.assert_allclose(found.bounds[:, :2], plain.bounds[:, :2], atol=1e-9)
    assert (found.face_normals[:, 2] < 0).all()
    flat = unbend_points(scene, found.vertices, bend)
    depth = imprint_depth(body, flat[:, 0], flat[:, 1])
    np.testing.assert_allclose(scene.pad.thickness - flat[:, 2], depth, atol=1e-9)
    assert depth.max() == pytest.approx(1.0)


def test_the_pyramids_are_those_of_the_layout(scene: Scene) -> None:
    body = pyramids(scene)
    np.testing.assert_array_equal(body.center, flat_sites(scene))
    corners = pyramid(scene)
    away = np.einsum("kci,ki->kc", corners, body.normal) - body.distance[:, None]
    np.testing.assert_allclose(away, 0.0, atol=1e-12)


def test_a_bolt_is_as_wide_and_deep_as_its_head(scene: Scene) -> None:
    head, body = BoltHead(), bolt(scene)
    end = np.array([[0.0, 0.0, -head.depth]])
    assert outside(body, end).max() == pytest.approx(0.0, abs=1e-12)
    assert outside(body, end * 1.01).max() > 0
    corner = head.imprint_radius * np.array([[0.0, 1.0, 0.0]])
    assert outside(body, 0.999 * corner).max() < 0 < outside(body, 1.001 * corner).max()


def test_a_bolt_stands_at_the_row_of_sites_nearest_to_the_base(scene: Scene) -> None:
    np.testing.assert_allclose(bolt(scene).center, [[0.0, -3.0, scene.pad.thickness]])


def test_a_bolt_that_does_not_fit_is_refused(scene: Scene) -> None:
    narrow = unchecked(scene, {"pad": unchecked(scene.pad, {"width": 6.0})})
    with pytest.raises(SceneError, match="does not fit into the pad of 6 x 30"):
        bolt(narrow)
    with pytest.raises(SceneError, match="pressed 4 mm deep"):
        bolt(scene, BoltHead(depth=4.0))


@pytest.mark.parametrize("bend", [0.0, np.pi / 2])
def test_a_bolt_lit_from_the_left_is_bright_there_and_dark_behind(
    scene: Scene, pressed: Preview, bend: float
) -> None:
    power = np.array([[edge == "left", 0, 0] for edge in fiber_edges(scene)], dtype=float)
    with_bolt, untouched = (
        pressed.picture(np.full(20, np.pi / 2), power, bend, 180, 300, indented=indented)[..., 0]
        for indented in (True, False)
    )
    changed = (untouched > 0) & (np.abs(with_bolt / np.maximum(untouched, 1e-30) - 1) > 0.1)
    # The head covers 5 % of the pad; its shadow adds to that.
    assert 0.03 < changed.sum() / (untouched > 0).sum() < 0.15
    rows, columns = np.nonzero(changed)
    row, middle = int(np.median(rows)), 90
    across = with_bolt[row] / np.maximum(untouched[row], 1e-30)
    edge = columns[rows == row]
    left, right = across[edge.min() : middle - 15], across[middle + 15 : edge.max() + 1]
    assert left.max() > 1.1
    assert right.min() < 0.8


def test_a_bolt_has_no_transport(pressed: Preview) -> None:
    with pytest.raises(GraphicsError, match="only the pyramids have transport"):
        pressed.transport(np.array([0.5]), np.array([0.0]))


def test_a_body_that_goes_through_a_dome_raises_one_clear_error(tmp_path: Path) -> None:
    dome = scene_of_case("dome")
    trimesh.creation.box((4.0, 4.0, 12.0)).export(tmp_path / "box.stl")
    with pytest.raises(SceneError, match=r"goes through the pad, which is 5.98 mm thick"):
        body_of_file(dome, tmp_path / "box.stl", depth=5.95)


def test_smoothed_skin_on_a_dome_lies_over_the_body_and_rounds_its_rim() -> None:
    dome = scene_of_case("dome")
    body = ball(dome, radius=2.0, depth=0.5)
    sharp, round_ = smoothed_skin(dome, body, 0.0), smoothed_skin(dome, body, 0.4)
    assert (round_.depth >= sharp.depth - 1e-12).all()
    assert round_.deepest == pytest.approx(sharp.deepest)
    assert (round_.depth > 0.02).sum() > 1.1 * (sharp.depth > 0.02).sum()
    # Deep places are as deep as straight down to the ball's planes.
    x, y = map_lines(dome)
    grid_x, grid_y = np.meshgrid(x, y)
    height = dome.pad.thickness + np.sqrt(30.0**2 - grid_x**2 - grid_y**2) - 30.0
    np.testing.assert_allclose(sharp.depth, imprint_depth(body, grid_x, grid_y, height), atol=1e-9)


def test_a_ball_on_a_dome_is_as_deep_as_said_and_follows_its_slope() -> None:
    dome = scene_of_case("dome")
    assert dome.skin is not None
    body = ball(dome, radius=2.0, depth=0.5)
    center, out = body.center[0], body.turn[0][:, 2]
    middle = center + 1.5 * out
    x, y = np.meshgrid(np.linspace(-1.0, 1.0, 21), np.linspace(-1.0, 1.0, 21))
    x, y = center[0] + x, center[1] + y
    height = dome.pad.thickness + dome.skin.rise(x, y)
    pressed = height - imprint_depth(body, x, y, height)
    away = np.linalg.norm(np.stack([x, y, pressed], axis=-1) - middle, axis=-1)
    deep = imprint_depth(body, x, y, height) > 0.05
    assert deep.sum() > 100
    np.testing.assert_allclose(away[deep], 2.0, atol=0.07)
