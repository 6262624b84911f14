"""States of a mesh skin: the material goes where its triangles go, and each is a sensor alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from render.errors import SceneError
from render.geometry import (
    StateChart,
    bend_points,
    camera_coverage,
    counted_sites,
    declared_sites,
    facets,
    fiber_poses,
    in_state,
    is_mirror_symmetric,
)
from render.geometry.meshes import pad_meshes
from render.scene import Scene
from tests.oracles.soft_domes import (
    LOW,
    MOVES,
    SIDES,
    rest_body,
    round_scene_text,
    scene_text_of,
    write_files,
    written,
)

CHORD = 3.5e-3
"""mm by which chords of the files' triangles leave the smooth skin through their samples."""
RNG = np.random.default_rng(5)
UV = RNG.uniform(-0.49, 0.49, (300, 2)) * SIDES


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("dome")
    write_files(folder)
    return folder


@pytest.fixture(scope="module")
def scene(folder: Path) -> Scene:
    return written(folder, scene_text_of(*MOVES))


def carried_by_triangles(name: str, folder: Path) -> np.ndarray:
    """Return where the triangle over each of UV takes it: all triangles are tried, one by one."""
    rest, moved = (trimesh.load_mesh(folder / f"{file}.stl") for file in ("rest", name))
    found = np.full((len(UV), 3), np.nan)
    for at_rest, now in zip(rest.triangles, moved.triangles, strict=True):
        if at_rest[:, 2].min() <= 0.0:
            continue  # not of the upper side
        matrix = np.concatenate([at_rest[:, :2].T, np.ones((1, 3))])
        if abs(np.linalg.det(matrix)) < 1e-9:
            continue
        weights = np.linalg.solve(matrix, np.concatenate([UV.T, np.ones((1, len(UV)))])).T
        inside = (weights >= -1e-9).all(axis=1)
        found[inside] = weights[inside] @ now
    return found


@pytest.mark.parametrize("name", MOVES)
def test_a_point_has_the_same_barycentric_coordinates_in_every_state(
    scene: Scene, folder: Path, name: str
) -> None:
    truth = carried_by_triangles(name, folder)
    assert np.isfinite(truth).all()
    found = StateChart(scene, float(scene.state_names.index(name))).points(UV)
    np.testing.assert_allclose(found, truth, atol=CHORD)


@pytest.mark.parametrize("name", MOVES)
def test_points_are_where_the_formula_moves_the_sphere(scene: Scene, name: str) -> None:
    chart = StateChart(scene, float(scene.state_names.index(name)))
    rest = StateChart(scene, 0.0).points(UV)
    np.testing.assert_allclose(chart.points(UV), MOVES[name](rest), atol=2 * CHORD)


def test_coordinates_come_back_in_every_state(scene: Scene) -> None:
    for state in scene.state_axis:
        chart = StateChart(scene, state)
        np.testing.assert_allclose(chart.uv(chart.points(UV)), UV, atol=1e-9)


def test_frames_turn_as_the_polar_decomposition_of_the_move_says(scene: Scene) -> None:
    for state in scene.state_axis:
        chart = StateChart(scene, state)
        frames, step = chart.frames(UV), 1e-4
        np.testing.assert_allclose(
            np.swapaxes(frames, -1, -2) @ frames, [np.eye(3)] * len(UV), atol=1e-12
        )
        along = [
            (chart.points(UV + s) - chart.points(UV - s)) / (2 * step) for s in np.eye(2) * step
        ]
        for part in along:
            np.testing.assert_allclose(np.einsum("ni,ni->n", part, frames[..., 2]), 0.0, atol=1e-6)
        # Seen from above, the rotation nearest to the move: by singular values, not by a formula.
        seen = np.stack([part[:, :2] for part in along], axis=-1)
        u, _, v = np.linalg.svd(seen)
        turn = np.arctan2(*np.moveaxis((u @ v)[:, [1, 0], 0], -1, 0))
        upright = StateChart(scene.in_state(state), 0.0).frames(chart.points(UV)[:, :2])
        between = np.swapaxes(upright, -1, -2) @ frames
        np.testing.assert_allclose(np.arctan2(between[:, 1, 0], between[:, 0, 0]), turn, atol=1e-6)


def test_a_plate_that_turns_turns_the_sites_about_their_normals(scene: Scene) -> None:
    turned = scene.in_state(2.0).sites.turns
    middle = declared_sites(scene)[:, :2].tolist().index([0.0, 0.0])
    assert turned[middle] == pytest.approx(np.arctan(0.05 / 1.09), rel=0.03)
    frame = facets(scene, 2.0).normal[middle] @ facets(scene, 0.0).normal[middle].T
    # Facets are 60 deg apart and turn as one body.
    np.testing.assert_allclose(np.diag(frame), np.diag(frame)[0], atol=2e-3)
    assert np.diag(frame)[0] < 1.0 - 1e-4


def test_bodies_with_moved_sites_are_closed_and_hold_their_pyramids(scene: Scene) -> None:
    for state in scene.state_axis:
        for indented in (True, False):
            meshes = pad_meshes(in_state(scene, state)[0], 0.0, indented)
            body = trimesh.util.concatenate([meshes.outer_clear, meshes.coating])
            body.merge_vertices()
            assert body.is_watertight
            assert (meshes.coating.area_faces > 0.0).all()
        corners = facets(scene, state).corners.reshape(-1, 3)
        vertices = pad_meshes(in_state(scene, state)[0], 0.0, True).coating.vertices
        apart = np.linalg.norm(corners[:, None] - vertices[None], axis=-1).min(axis=1)
        np.testing.assert_allclose(apart, 0.0, atol=1e-12)


def test_a_state_that_moves_nothing_aside_is_a_plain_scene_of_that_mesh(
    scene: Scene, folder: Path
) -> None:
    plain = written(folder, scene_text_of(mesh="low.stl", crown=6.0 * LOW))
    one, bend = in_state(scene, float(scene.state_names.index("low")))
    assert bend == 0.0
    assert one.pad.thickness == pytest.approx(plain.pad.thickness, abs=1e-6)
    assert one.sites == plain.sites
    uv = declared_sites(scene)[:, :2]
    np.testing.assert_allclose(facets(one, 0.0).corners, facets(plain, 0.0).corners, atol=1e-6)
    np.testing.assert_allclose(declared_sites(one)[:, :2], uv, atol=0.0)


def test_the_rest_is_the_scene_without_states(scene: Scene, folder: Path) -> None:
    plain = written(folder, scene_text_of())
    one, _ = in_state(scene, 0.0)
    assert one.hash == plain.hash
    assert scene.hash != plain.hash
    assert in_state(plain, 0.0) == (plain, 0.0)


def test_lamps_and_camera_stay_where_they_are(scene: Scene) -> None:
    for state in scene.state_axis:
        one, _ = in_state(scene, state)
        for sensor, at in ((one, 0.0), (scene, state)):
            np.testing.assert_array_equal(
                fiber_poses(sensor, at).position, fiber_poses(scene, 0.0).position
            )
        assert one.camera == scene.camera


def test_a_site_that_one_state_hides_counts_in_none(scene: Scene, folder: Path) -> None:
    text = scene_text_of("pressed", "low")
    for old, new in (("= 65.0", "= 29.0"), ("columns = 320", "columns = 160"), ("= 400", "= 200")):
        text = text.replace(old, new)
    scene = written(folder, text)
    seen = camera_coverage(scene).seen.all(axis=2)
    # The plate pushes skin outwards, out of the picture of a narrow camera.
    assert seen[0].sum() > seen[1].sum()
    assert "(over 3 states)" in camera_coverage(scene).sentence
    counted = np.flatnonzero(seen.all(axis=0))
    for state in scene.state_axis:
        np.testing.assert_array_equal(counted_sites(in_state(scene, state)[0]), counted)
    np.testing.assert_array_equal(counted_sites(scene), counted)


def test_sites_that_no_state_shares_raise_one_clear_error(folder: Path) -> None:
    text = scene_text_of("pressed")
    for old, new in (
        ("= 65.0", "= 20.0"),
        ("camera.y = { value = 0.0", "camera.y = { value = 60.0"),
    ):
        text = text.replace(old, new)
    with pytest.raises(SceneError, match="none of 9 sites whole in every state"):
        in_state(written(folder, text), 0.0)


def test_symmetry_is_that_of_all_states(folder: Path) -> None:
    phi = np.full((6, 1), np.pi / 2)
    assert is_mirror_symmetric(written(folder, round_scene_text(60.0, crown=5.0)), phi)
    assert not is_mirror_symmetric(written(folder, scene_text_of("low", "twisted")), phi)


@pytest.mark.parametrize("shape", ["dome", "arch"])
def test_round_skins_have_states_of_other_radii_whose_skin_moves_straight_down(
    folder: Path, shape: str
) -> None:
    scene = written(folder, round_scene_text(60.0, shape=shape, crown=5.0))
    half = np.abs(UV[:, 0]) if shape == "arch" else np.hypot(*UV.T)
    height = 5.0 - 60.0 + np.sqrt(60.0**2 - half**2)
    points = StateChart(scene, 1.0).points(UV)
    np.testing.assert_allclose(points, np.column_stack([UV, height]), atol=1e-9)
    same = written(folder, round_scene_text(60.0, shape=shape))
    assert same.in_state(1.0).pad.thickness == same.pad.thickness


def test_a_number_of_no_state_raises_one_clear_error(scene: Scene) -> None:
    with pytest.raises(SceneError, match=r"state 4 of soft-dome, allowed: .* \(rest, pressed"):
        in_state(scene, 4.0)
    with pytest.raises(SceneError, match="take the sensor in that state"):
        bend_points(scene, np.zeros((1, 3)), 1.0)


def test_files_hold_what_the_formulas_say(folder: Path) -> None:
    assert len(trimesh.load_mesh(folder / "twisted.stl").faces) == len(rest_body().faces)
