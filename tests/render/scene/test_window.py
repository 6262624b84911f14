"""A window under the pad: what is read, what is refused, and what camera rays do in it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy import optimize

from render.errors import SceneError
from render.geometry import aim_at, camera_origin, flat_fiber_poses, refract_into_pad
from render.geometry.meshes import pad_meshes
from render.preview.bonded import bond_of, with_bonded_window
from render.scene import FACES, Scene, load_scene, scene_content, scene_of
from tests.oracles.pads import scene_of_case
from tests.render.geometry.test_meshes import flipped, joined

TEXT = (Path(__file__).parents[3] / "render" / "scenes" / "digit.toml").read_text()
PLAIN = load_scene("digit")
SCENE = scene_of_case("window lit at its edges")
LIKE_THE_PAD = scene_of_case("window like the pad")
GEL = {"value": 1.41, "source": "silicone"}


def scene_with(folder: Path, thickness: float = 2.0, index: float = 1.49, **change: str) -> Scene:
    """Return digit on a window; ``change`` replaces what stands in its file."""
    text = TEXT
    for old, new in change.items():
        assert old in text
        text = text.replace(old, new)
    text += (
        f'\n[window]\nthickness = {{ value = {thickness}, unit = "mm", source = "plate" }}\n'
        f'index = {{ value = {index}, source = "acrylic" }}\n'
    )
    path = folder / "scene.toml"
    path.write_text(text)
    return load_scene(path)


def test_a_window_lies_under_the_pad_and_makes_another_scene(tmp_path: Path) -> None:
    scene = scene_with(tmp_path)
    assert scene.hash != PLAIN.hash
    assert scene_of(scene_content(scene)) == scene
    np.testing.assert_array_equal(scene.box.low - PLAIN.box.low, [0.0, 0.0, -2.0])
    np.testing.assert_array_equal(scene.box.high, PLAIN.box.high)
    assert scene_with(tmp_path, index=1.5).hash != scene.hash != scene_with(tmp_path, 2.1).hash


def test_lamps_below_the_pad_stand_before_the_window() -> None:
    poses = flat_fiber_poses(SCENE)
    assert [FACES[face] for face in poses.face] == ["left", "tip", "tip"]
    np.testing.assert_allclose(poses.foot[:, 2], [-1.5, -2.0, -2.0])
    np.testing.assert_allclose(poses.gap, 0.6)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            {'value = [0.0], unit = "deg"': 'value = [0.0, 30.0], unit = "deg"'},
            "window: bending.angles = 0, 30 deg, allowed with a window: 0 deg alone",
        ),
        ({"schema = 2": "schema = 1"}, "window needs schema = 2"),
        (
            {
                "[coating]": '[skin]\nshape = "dome"\n'
                'radius = { value = 30.0, unit = "mm", source = "a" }\n[coating]'
            },
            "window: skin.shape = dome, allowed with a window: a flat skin",
        ),
        (
            {"value = 1.49, source": "value = 1.0, source"},
            "window: pad.index = 1, allowed with a window: at least 1.2",
        ),
        (
            {"value = 15.0, unit": "value = 1.5, unit"},
            "window.thickness = 2 mm reaches to the camera at z = -1.5 mm, allowed: less than 1.5",
        ),
        (
            {
                "[coating]": '[diffuser]\nthickness = { value = 1.0, unit = "mm", source = "a" }\n'
                'sigma_s = { value = 4.0, unit = "1/mm", source = "a" }\n'
                'sigma_a = { value = 0.1, unit = "1/mm", source = "a" }\n'
                'g = { value = 0.7, source = "a" }\n[coating]'
            },
            "window: there is a diffuser, allowed: one of the two, leave one out",
        ),
    ],
)
def test_what_no_window_can_lie_under_is_refused(
    tmp_path: Path, change: dict[str, str], said: str
) -> None:
    with pytest.raises(SceneError) as caught:
        scene_with(tmp_path, **change)
    assert said in str(caught.value)


def test_a_plate_of_no_plate_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"window.index = 1.0: allowed: 1.2 to 1.9"):
        scene_with(tmp_path, index=1.0)
    with pytest.raises(SceneError, match=r"window.thickness = 0.0: allowed: 0.01 to 1000 mm"):
        scene_with(tmp_path, thickness=0.0)


@pytest.mark.parametrize("indented", [True, False])
def test_pad_and_window_are_closed_and_share_their_bond(indented: bool) -> None:
    meshes = pad_meshes(SCENE, 0.0, indented)
    window = meshes.window
    assert window is not None
    pad = joined(flipped(meshes.coating), meshes.outer_clear, window.bond)
    plate = joined(flipped(window.bond), window.outer)
    whole = joined(flipped(meshes.coating), meshes.outer_clear, window.outer)
    for mesh in (pad, plate, whole):
        assert mesh.is_watertight
        assert mesh.is_winding_consistent
    assert plate.volume == pytest.approx(20.0 * 24.0 * 3.0)
    assert pad.volume + plate.volume == pytest.approx(whole.volume)
    outward = {FACES[k]: window.outer.face_normals[window.side == k].mean(axis=0) for k in range(5)}
    np.testing.assert_allclose(outward["lower"], [0.0, 0.0, -1.0])
    np.testing.assert_allclose(outward["tip"], [0.0, 1.0, 0.0], atol=1e-12)


def test_camera_rays_take_the_least_time() -> None:
    origin, window = camera_origin(SCENE), SCENE.window
    assert window is not None
    points = np.array([[5.0, -7.0, 4.5], [-8.0, 3.0, 4.0], [0.0, 0.0, 4.5]])
    directions, hit = aim_at(SCENE, 0.0, origin, points)
    assert hit.all()
    rays = refract_into_pad(SCENE, 0.0, origin, directions)
    for point, direction, entry in zip(points, directions, rays.entry, strict=True):

        def time(place: np.ndarray, point: np.ndarray = point) -> float:
            below, above = np.append(place[:2], -3.0), np.append(place[2:], 0.0)
            legs = below - origin, above - below, point - above
            indices = 1.0, window.index, SCENE.pad.index
            return float(sum(n * np.linalg.norm(leg) for n, leg in zip(indices, legs, strict=True)))

        # Fermat: where the way crosses both faces.
        found = optimize.minimize(time, np.tile(point[:2] / 2, 2), tol=1e-14).x
        np.testing.assert_allclose(entry, [*found[2:], 0.0], atol=2e-5)
        first = np.append(found[:2], -3.0) - origin
        np.testing.assert_allclose(direction, first / np.linalg.norm(first), atol=2e-6)


def test_rays_beside_the_plate_see_no_pad() -> None:
    origin = camera_origin(SCENE)
    aims = np.array([[9.9, 0.0, -3.0], [10.1, 0.0, -3.0], [0.0, 12.1, -3.0]]) - origin
    aims /= np.linalg.norm(aims, axis=1, keepdims=True)
    # The first goes on beyond the pad's edge within the plate.
    assert refract_into_pad(SCENE, 0.0, origin, aims).inside.tolist() == [False, False, False]


def test_a_window_of_the_pads_index_is_more_pad_to_the_preview() -> None:
    thick = with_bonded_window(LIKE_THE_PAD)
    assert (thick.pad.thickness, thick.window) == (7.5, None)
    assert camera_origin(thick)[2] == -17.0
    shift = flat_fiber_poses(thick).position - flat_fiber_poses(LIKE_THE_PAD).position
    np.testing.assert_allclose(shift, np.tile([0.0, 0.0, 3.0], (3, 1)))
    assert with_bonded_window(thick) is thick
    # The camera sees the same of both.
    directions = np.array([[0.2, 0.1, 1.0], [-0.1, -0.3, 1.0]])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    one, other = (
        refract_into_pad(scene, 0.0, camera_origin(scene), directions)
        for scene in (LIKE_THE_PAD, thick)
    )
    np.testing.assert_allclose(one.direction, other.direction, atol=1e-12)
    along = one.entry + one.direction * (-3.0 / one.direction[:, 2:])
    np.testing.assert_allclose(along + [0.0, 0.0, 3.0], other.entry, atol=1e-12)


def test_where_light_bends_is_where_the_indices_meet() -> None:
    assert bond_of(SCENE) == (3.0, 1.49)
    assert bond_of(LIKE_THE_PAD) is bond_of(PLAIN) is None
