"""The pad's meshes close, keep their length and face the stated way."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import trimesh

from render.geometry import bend_frames, facets, flat_sites, pyramids, unbend_points
from render.geometry.meshes import MAX_SAG, PadMeshes, imprinted_coating, pad_meshes
from render.scene import OUTWARD, Scene, load_scene, unchecked
from tests.oracles.pads import SKINS, scene_of_case

SCENE = load_scene("finger20")
BARE = unchecked(SCENE, {"diffuser": None})
SIDES = {
    " ".join(edges): unchecked(SCENE, {"diffuser": unchecked(SCENE.diffuser, {"on": edges})})
    for edges in (("left",), ("tip", "base"), ("left", "tip", "right", "base"))
    if SCENE.diffuser
}
BENDS = np.radians([0.0, 45.0, 90.0, 180.0])
CASES = [
    pytest.param(scene, bend, indented, id=f"{name}-{np.degrees(bend):.0f}deg-{indented}")
    for (name, scene), bend, indented in itertools.product(
        [("diffuser", SCENE), ("bare", BARE)], [*BENDS, 1e-6], [True, False]
    )
] + [
    pytest.param(scene, bend, indented, id=f"{name}-{np.degrees(bend):.0f}deg-{indented}")
    for name, scene in SIDES.items()
    for bend, indented in ((0.0, True), (BENDS[2], False))
]


def joined(*meshes: trimesh.Trimesh | None) -> trimesh.Trimesh:
    """Concatenate and merge identical vertices, bit for bit."""
    whole = trimesh.util.concatenate([mesh for mesh in meshes if mesh is not None])
    points, number = np.unique(whole.vertices, axis=0, return_inverse=True)
    return trimesh.Trimesh(points, number.ravel()[whole.faces], process=False)


def flipped(mesh: trimesh.Trimesh | None) -> trimesh.Trimesh:
    """Return the mesh with its normals reversed."""
    assert mesh is not None
    return trimesh.Trimesh(mesh.vertices, mesh.faces[:, ::-1], process=False)


def block(meshes: PadMeshes) -> trimesh.Trimesh:
    """Return the closed surface of all silicone, normals out."""
    return joined(flipped(meshes.coating), meshes.outer_clear, meshes.outer_diffuser)


def clear_pad(meshes: PadMeshes) -> trimesh.Trimesh:
    """Return the closed surface of the clear pad, normals out."""
    inner = [flipped(meshes.interface)] if meshes.interface else []
    return joined(flipped(meshes.coating), meshes.outer_clear, *inner)


def pyramid_volume(scene: Scene) -> float:
    k, radius = scene.indenter.faces, scene.indenter.radius
    base = 0.5 * k * radius**2 * np.sin(2 * np.pi / k)
    return float(base * radius * np.cos(np.pi / k) * np.tan(scene.indenter.slope) / 3)


@pytest.mark.parametrize(("scene", "bend", "indented"), CASES)
def test_all_faces_together_close_the_block(scene: Scene, bend: float, indented: bool) -> None:
    whole = block(pad_meshes(scene, bend, indented))
    assert whole.is_watertight
    assert whole.is_winding_consistent
    assert whole.volume > 0


@pytest.mark.parametrize(("scene", "bend", "indented"), CASES)
def test_the_interface_closes_both_the_clear_pad_and_the_diffuser(
    scene: Scene, bend: float, indented: bool
) -> None:
    meshes = pad_meshes(scene, bend, indented)
    pad = clear_pad(meshes)
    assert pad.is_watertight
    assert pad.is_winding_consistent
    if meshes.interface is None:
        assert scene.diffuser is None
        assert meshes.outer_diffuser is None
        return
    layer = joined(meshes.outer_diffuser, meshes.interface)
    assert layer.is_watertight
    assert layer.is_winding_consistent
    assert layer.volume > 0
    assert pad.volume + layer.volume == pytest.approx(block(meshes).volume)


@pytest.mark.parametrize(("scene", "bend", "indented"), CASES)
def test_no_face_is_degenerate(scene: Scene, bend: float, indented: bool) -> None:
    for mesh in vars(pad_meshes(scene, bend, indented)).values():
        if isinstance(mesh, trimesh.Trimesh):
            assert mesh.area_faces.min() > 1e-4


@pytest.mark.parametrize("indented", [True, False])
def test_flat_volumes_are_the_analytic_ones(indented: bool) -> None:
    meshes = pad_meshes(SCENE, 0.0, indented)
    pressed = SCENE.sites.count * pyramid_volume(SCENE) if indented else 0.0
    assert clear_pad(meshes).volume == pytest.approx(18 * 30 * 4 - pressed, rel=1e-12)
    layer = joined(meshes.outer_diffuser, meshes.interface)
    assert layer.volume == pytest.approx((2 * 2 * 32 + 18 * 2) * 4, rel=1e-12)


@pytest.mark.parametrize("bend", BENDS[1:])
def test_bent_volume_is_that_of_the_annular_sector(bend: float) -> None:
    radius = SCENE.pad.length / bend
    sector = 0.5 * bend * ((radius + 4) ** 2 - radius**2) * 18
    assert clear_pad(pad_meshes(SCENE, bend, False)).volume == pytest.approx(sector, rel=2e-3)


@pytest.mark.parametrize("bend", BENDS)
def test_the_coating_keeps_its_area_when_bent(bend: float) -> None:
    assert pad_meshes(SCENE, bend, False).coating.area == pytest.approx(18 * 30, rel=2e-4)


def test_a_flat_untouched_pad_needs_two_coating_triangles() -> None:
    assert len(pad_meshes(BARE, 0.0, False).coating.faces) == 2


@pytest.mark.parametrize("bend", BENDS)
@pytest.mark.parametrize("indented", [True, False])
def test_coating_normals_point_into_the_pad(bend: float, indented: bool) -> None:
    coating = pad_meshes(SCENE, bend, indented).coating
    center = coating.triangles_center
    axis_height = SCENE.pad.thickness + (SCENE.pad.length / bend if bend else 1e9)
    outwards = (center - [0.0, SCENE.camera.y, axis_height]) * [0.0, 1.0, 1.0]
    assert (np.einsum("fi,fi->f", outwards, coating.face_normals) > 0).all()


def test_interface_normals_point_from_the_diffuser_into_the_pad() -> None:
    interface = pad_meshes(SCENE, 0.0, True).interface
    assert interface is not None
    center, normal = interface.triangles_center, interface.face_normals
    left, right = center[:, 0] < -8.99, center[:, 0] > 8.99
    np.testing.assert_allclose(normal[left], [[1, 0, 0]] * left.sum(), atol=1e-12)
    np.testing.assert_allclose(normal[right], [[-1, 0, 0]] * right.sum(), atol=1e-12)
    tip = ~(left | right)
    np.testing.assert_allclose(normal[tip], [[0, -1, 0]] * tip.sum(), atol=1e-12)
    assert interface.area == pytest.approx((30 + 30 + 18) * 4)


def test_outer_faces_are_sorted_by_what_they_border() -> None:
    meshes = pad_meshes(SCENE, 0.0, False)
    assert meshes.outer_diffuser is not None
    assert meshes.outer_clear.area == pytest.approx(18 * 30 + 18 * 4)
    strips = 2 * (2 * 2 * 32 + 18 * 2)
    sides = (32 + 32 + 22 + 2 + 2) * 4
    assert meshes.outer_diffuser.area == pytest.approx(strips + sides)
    bare = pad_meshes(BARE, 0.0, False)
    assert bare.outer_clear.area == pytest.approx(18 * 30 + 2 * (18 + 30) * 4)


@pytest.mark.parametrize("bend", BENDS)
def test_every_facet_is_one_face_with_the_corners_of_the_layout(bend: float) -> None:
    meshes = pad_meshes(SCENE, bend, True)
    layout = facets(SCENE, bend)
    for site, facet in itertools.product(range(SCENE.sites.count), range(SCENE.indenter.faces)):
        corners = layout.corners[site, facet]
        (face,) = np.nonzero(np.abs(meshes.coating.triangles - corners).max(axis=(1, 2)) < 1e-12)[0]
        np.testing.assert_allclose(
            meshes.coating.face_normals[face], layout.normal[site, facet], atol=1e-9
        )


@pytest.mark.parametrize("bend", BENDS)
def test_the_ring_around_a_pyramid_stays_close_to_the_coating(bend: float) -> None:
    coating = pad_meshes(SCENE, bend, True).coating
    flat = flat_sites(SCENE)
    turn = bend_frames(SCENE, flat[:, 1], bend)
    for site in range(SCENE.sites.count):
        offset = coating.vertices - facets(SCENE, bend).site_position[site]
        local = offset @ turn[site]
        near = np.abs(local[:, :2]).max(axis=1) < 0.91
        assert local[near, 2].max() < 0.05


@pytest.mark.parametrize("faces", [3, 4, 7, 64])
@pytest.mark.parametrize("spacing", [1.8, 3.0])
def test_any_pyramid_on_touching_cells_closes(faces: int, spacing: float) -> None:
    indenter = unchecked(SCENE.indenter, {"faces": faces})
    sites = unchecked(SCENE.sites, {"spacing": spacing})
    scene = unchecked(SCENE, {"indenter": indenter, "sites": sites})
    for bend in (0.0, 1.2):
        whole = block(pad_meshes(scene, bend, True))
        assert whole.is_watertight
        assert whole.is_winding_consistent
        coating = pad_meshes(scene, bend, True).coating
        assert coating.area_faces.min() > 1e-5
        assert (coating.face_normals[:, 2] < 0).all()


@pytest.mark.parametrize("bend", BENDS)
def test_triangles_know_the_side_of_the_block_that_they_are_on(bend: float) -> None:
    for scene in (SCENE, BARE):
        meshes = pad_meshes(scene, bend, True)
        for mesh, side in (
            (meshes.outer_clear, meshes.clear_side),
            (meshes.outer_diffuser, meshes.diffuser_side),
        ):
            if mesh is None:
                continue
            # Across the pad, and at its middle also along it, normals are those of the flat block.
            outward = np.vstack([OUTWARD, [[0.0, 0.0, 1.0]]])[side]
            flat = unbend_points(scene, mesh.triangles_center, bend)
            turn = bend_frames(scene, flat[:, 1], bend)
            expected = np.einsum("fij,fj->fi", turn, outward)
            assert ((mesh.face_normals * expected).sum(axis=1) > 0.99).all()


@pytest.mark.parametrize("case", SKINS.values())
@pytest.mark.parametrize("indented", [False, True])
def test_a_curved_skin_closes_its_pad_and_sags_by_less_than_is_said(
    case: str, indented: bool
) -> None:
    scene = scene_of_case(case)
    meshes, skin = pad_meshes(scene, 0.0, indented), scene.skin
    assert skin is not None
    coating, whole = meshes.coating, block(meshes)
    assert whole.is_watertight
    assert whole.is_winding_consistent
    assert whole.volume > 0
    if indented:
        return
    middle = coating.triangles_center
    sag = scene.pad.thickness + skin.rise(middle[:, 0], middle[:, 1]) - middle[:, 2]
    assert np.abs(sag).max() < 2 * MAX_SAG
    x, y = np.meshgrid(*(np.linspace(-0.5, 0.5, 801) * side for side in scene_size(scene)))
    exact = (scene.pad.thickness + skin.rise(x, y)).mean() * np.prod(scene_size(scene))
    assert whole.volume == pytest.approx(exact, rel=1e-3)


def scene_size(scene: Scene) -> tuple[float, float]:
    return scene.pad.width, scene.pad.length


@pytest.mark.parametrize("case", SKINS.values())
def test_a_body_pressed_into_a_curved_skin_stands_on_it(case: str) -> None:
    scene = scene_of_case(case)
    found = imprinted_coating(scene, 0.0, pyramids(scene)).vertices
    pressed = scene.pad.thickness + scene.skin.rise(found[:, 0], found[:, 1]) - found[:, 2]
    shape = facets(scene, 0.0)
    # Where the fine grid comes near an apex, it is as deep as that.
    apex = shape.corners[:, 0, 0]
    near = np.linalg.norm(found[None, :, :2] - apex[:, None, :2], axis=-1).argmin(axis=1)
    np.testing.assert_allclose(found[near, 2], apex[:, 2], atol=0.06)
    away = np.linalg.norm(found[None, :, :2] - shape.site_position[:, None, :2], axis=-1)
    assert (pressed[(away > 1.2 * scene.indenter.radius).all(axis=0)] < 1e-9).all()
    assert (pressed > -1e-9).all()
