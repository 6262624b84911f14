"""Plane faces of pads are where their meshes are."""

from __future__ import annotations

import numpy as np
import pytest

from render.geometry.meshes import pad_meshes
from render.pad import PlaneFace, mirror_faces, plane_faces
from render.scene import FACES
from tests.oracles.pads import scene_of_case

CASES = [
    "smooth", "rim", "window", "mirror walls", "smooth bent 45", "mirror walls bent 45",
    "rim bent 45",
]  # fmt: skip


def lies_in(face: PlaneFace, corners: np.ndarray, normal: np.ndarray) -> bool:
    """Return whether a triangle ``(corner, 3)`` of that outward ``normal`` is part of a face."""
    offset = corners - face.point
    aside, along = offset @ face.inward, offset @ face.along
    flat = np.abs(aside).max() < 1e-9 and normal @ face.inward < -1.0 + 1e-9
    return bool(flat and along.min() > -1e-9 and along.max() < face.length + 1e-9)


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("indented", [False, True])
def test_triangles_beside_the_air_lie_in_the_face_that_they_are_of(
    case: str, indented: bool
) -> None:
    scene = scene_of_case(case)
    bend = scene.bending.angles[0]
    groups = plane_faces(scene, bend, indented)
    meshes = pad_meshes(scene, bend, indented)
    found: set[PlaneFace] = set()
    parts = [(meshes.outer_clear, meshes.clear_side)]
    if meshes.outer_diffuser is not None:
        parts.append((meshes.outer_diffuser, meshes.diffuser_side))
    if meshes.window is not None:
        parts.append((meshes.window.outer, meshes.window.side))
    for mesh, side in parts:
        for corners, normal, number in zip(mesh.triangles, mesh.face_normals, side, strict=True):
            if number == len(FACES):  # the far side of a diffuser
                continue
            at = [face for group in groups for face in group if lies_in(face, corners, normal)]
            assert [face.number for face in at] == [number]
            found.update(at)
    assert found == {face for group in groups for face in group}


@pytest.mark.parametrize("case", CASES)
def test_groups_are_at_right_angles(case: str) -> None:
    scene = scene_of_case(case)
    groups = plane_faces(scene, scene.bending.angles[0], False)
    for i, group in enumerate(groups):
        for other in groups[:i]:
            assert all(abs(a.inward @ b.inward) < 1e-12 for a in group for b in other)


def test_mirrors_are_smooth_boundaries_to_the_air_and_metal() -> None:
    assert mirror_faces(scene_of_case("smooth")).all()
    assert not mirror_faces(scene_of_case("no face")).any()
    assert not mirror_faces(scene_of_case("rough 0.1")).any()
    by_name = dict(zip(FACES, mirror_faces(scene_of_case("mirror walls rough 0.1")), strict=True))
    assert {face for face, mirror in by_name.items() if mirror} == {"right", "base"}
    by_name = dict(zip(FACES, mirror_faces(scene_of_case("white walls")), strict=True))
    assert not by_name["right"]
    assert by_name["left"]
