"""Fibers, sites and facets are where the conventions say, at any bend."""

from __future__ import annotations

import numpy as np
import pytest

from render.geometry import (
    facet_normals,
    facets,
    fiber_edges,
    fiber_poses,
    flat_fiber_poses,
    flat_sites,
    mirror_twins,
    pyramid,
)
from render.scene import Scene, load_scene, unchecked

SCENE = load_scene("finger20")
BENDS = [0.0, 1e-6, np.pi / 4, np.pi / 2, np.pi]
MIRROR = np.array([-1.0, 1.0, 1.0])


def with_fibers(**values: float) -> Scene:
    return unchecked(SCENE, {"fibers": unchecked(SCENE.fibers, values)})


def test_fibers_run_around_the_pad_from_the_left_base_to_the_right_base() -> None:
    assert fiber_edges(SCENE) == ["left"] * 8 + ["tip"] * 4 + ["right"] * 8
    position = flat_fiber_poses(SCENE).position
    outside = 2.0 + SCENE.fibers.gap
    np.testing.assert_allclose(position[:8, 0], -9.0 - outside)
    np.testing.assert_allclose(position[8:12, 1], 15.0 + outside)
    np.testing.assert_allclose(position[12:, 0], 9.0 + outside)
    assert (np.diff(position[:8, 1]) > 0).all()
    assert (np.diff(position[8:12, 0]) > 0).all()
    assert (np.diff(position[12:, 1]) < 0).all()
    np.testing.assert_allclose(position[:, 2], SCENE.fibers.height)


def test_without_a_diffuser_fibers_stand_at_the_pad() -> None:
    bare = unchecked(SCENE, {"diffuser": None})
    assert flat_fiber_poses(bare).position[0, 0] == pytest.approx(-9.0 - SCENE.fibers.gap)


@pytest.mark.parametrize("counts", [(0, 4, 0), (8, 0, 8), (1, 0, 0), (7, 6, 11)])
def test_any_edge_may_be_dark(counts: tuple[int, int, int]) -> None:
    scene = with_fibers(**dict(zip(("left", "tip", "right"), counts, strict=True)))
    poses = fiber_poses(scene, 0.5)
    assert poses.position.shape == poses.along.shape == (sum(counts), 3)


@pytest.mark.parametrize("bend", BENDS)
def test_half_pi_points_into_the_pad_and_zero_along_the_edge(bend: float) -> None:
    poses = fiber_poses(with_fibers(tilt=0.0), bend)
    inward = poses.directions(np.full(20, np.pi / 2))
    np.testing.assert_allclose(inward, poses.inward, atol=1e-15)
    np.testing.assert_allclose(poses.directions(np.zeros(20)), poses.along)
    np.testing.assert_allclose(poses.inward[:8], [[1, 0, 0]] * 8, atol=1e-15)
    np.testing.assert_allclose(poses.along[8:12], [[1, 0, 0]] * 4, atol=1e-15)
    np.testing.assert_allclose(poses.inward[12:], [[-1, 0, 0]] * 8, atol=1e-15)


@pytest.mark.parametrize("bend", BENDS)
def test_the_tilt_lifts_every_beam_towards_the_coating(bend: float) -> None:
    poses = fiber_poses(SCENE, bend)
    tilt = SCENE.fibers.tilt
    beams = poses.directions(np.linspace(0, np.pi, 20))
    np.testing.assert_allclose(np.linalg.norm(beams, axis=1), 1.0)
    np.testing.assert_allclose(np.einsum("fi,fi->f", beams, poses.up), np.sin(tilt))


def test_directions_take_a_batch_of_designs() -> None:
    phi = np.linspace(0, np.pi, 60).reshape(3, 20)
    assert fiber_poses(SCENE, 0.0).directions(phi).shape == (3, 20, 3)


@pytest.mark.parametrize("bend", BENDS)
def test_fibers_are_mirror_images_in_the_plane_x_zero(bend: float) -> None:
    poses, twin = fiber_poses(SCENE, bend), mirror_twins(SCENE).twin
    np.testing.assert_allclose(poses.position[twin], poses.position * MIRROR, atol=1e-12)
    phi = np.linspace(0.1, 3.0, 20)
    flips = mirror_twins(SCENE).flips
    assert flips.tolist() == [edge == "tip" for edge in fiber_edges(SCENE)]
    mirrored_phi = np.where(flips, np.pi - phi[twin], phi[twin])
    beams = poses.directions(phi)[twin]
    expected = poses.directions(mirrored_phi) * MIRROR
    np.testing.assert_allclose(beams * MIRROR, expected * MIRROR, atol=1e-12)


def test_unequal_sides_have_no_mirror_image() -> None:
    assert mirror_twins(with_fibers(left=7)) is None


def test_sites_run_row_by_row_from_the_base_left() -> None:
    sites = flat_sites(SCENE)
    assert sites.shape == (15, 3)
    np.testing.assert_allclose(sites[:3, 0], [-3, 0, 3])
    np.testing.assert_allclose(sites[::3, 1], [-3, 0, 3, 6, 9])
    np.testing.assert_allclose(sites[:, 2], SCENE.pad.thickness)


def test_facet_normals_follow_eq_4_2() -> None:
    normals = facet_normals(SCENE)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0)
    np.testing.assert_allclose(np.arccos(-normals[:, 2]), SCENE.indenter.slope)
    azimuth = np.arctan2(normals[:, 0], normals[:, 1]) % (2 * np.pi)
    np.testing.assert_allclose(azimuth, 2 * np.pi * np.arange(10) / 10, atol=1e-12)


@pytest.mark.parametrize("faces", [3, 4, 10, 64])
def test_the_pyramid_has_the_stated_normals_and_one_apex(faces: int) -> None:
    indenter = unchecked(SCENE.indenter, {"faces": faces})
    scene = unchecked(SCENE, {"indenter": indenter})
    corners = pyramid(scene)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    np.testing.assert_allclose(normal, facet_normals(scene), atol=1e-12)
    np.testing.assert_allclose(corners[:, 0], [[0, 0, -indenter.depth]] * faces)
    np.testing.assert_allclose(np.linalg.norm(corners[:, 1:, :2], axis=-1), indenter.radius)
    np.testing.assert_allclose(corners[:, 2], np.roll(corners[:, 1], -1, axis=0), atol=1e-12)


@pytest.mark.parametrize("bend", BENDS)
def test_pyramids_are_rigid_and_turn_with_their_site(bend: float) -> None:
    placed = facets(SCENE, bend)
    size = np.linalg.norm(placed.corners - placed.site_position[:, None, None], axis=-1)
    flat_size = np.broadcast_to(np.linalg.norm(pyramid(SCENE), axis=-1), size.shape)
    np.testing.assert_allclose(size, flat_size, atol=1e-12)
    cosine = np.einsum("sfi,si->sf", placed.normal, placed.site_normal)
    np.testing.assert_allclose(np.arccos(cosine), SCENE.indenter.slope)
    edges = placed.corners[..., 1:, :] - placed.corners[..., :1, :]
    np.testing.assert_allclose(np.einsum("sfci,sfi->sfc", edges, placed.normal), 0, atol=1e-12)
    assert placed.centroid.shape == (15, 10, 3)


@pytest.mark.parametrize("bend", BENDS)
def test_sites_and_facets_are_mirror_images(bend: float) -> None:
    placed = facets(SCENE, bend)
    site_twin = np.arange(15).reshape(5, 3)[:, ::-1].ravel()
    facet_twin = (10 - np.arange(10)) % 10
    for array in (placed.centroid, placed.normal):
        np.testing.assert_allclose(array[site_twin][:, facet_twin], array * MIRROR, atol=1e-12)


def test_almost_no_bend_is_no_bend() -> None:
    flat, almost = facets(SCENE, 0.0), facets(SCENE, 1e-6)
    np.testing.assert_allclose(almost.corners, flat.corners, atol=1e-5)
    np.testing.assert_allclose(almost.normal, flat.normal, atol=1e-6)
