"""What mirror symmetry says about transport."""

from __future__ import annotations

import numpy as np
import pytest

from render.arrays import Array
from render.chebyshev import chebyshev_nodes
from render.geometry import (
    bend_points,
    facet_normals,
    fiber_poses,
    flat_sites,
    is_mirror_symmetric,
    mirror_image,
)
from render.scene import Scene, load_scene, unchecked


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("finger20")


def nodes(scene: Scene) -> Array:
    return np.tile(chebyshev_nodes(4, 0.0, np.pi), (scene.lamp_count, 1))


@pytest.mark.parametrize("facets", [True, False])
@pytest.mark.parametrize("leading", [(), (2,)])
def test_mirroring_twice_changes_nothing(
    scene: Scene, facets: bool, leading: tuple[int, ...]
) -> None:
    shape = (*leading, scene.lamp_count, 4, 2, scene.sites.count)
    shape += (scene.indenter.faces,) if facets else ()
    values = np.random.default_rng(1).random(shape)
    once = mirror_image(scene, values, facets=facets)
    assert (once != values).any()
    np.testing.assert_array_equal(mirror_image(scene, once, facets=facets), values)


def test_the_default_sensor_with_chebyshev_nodes_is_its_own_mirror_image(scene: Scene) -> None:
    assert is_mirror_symmetric(scene, nodes(scene))


def test_directions_that_differ_between_left_and_right_break_the_mirror(scene: Scene) -> None:
    phi = nodes(scene)
    phi[0] += 0.01
    assert not is_mirror_symmetric(scene, phi)


def test_tip_directions_that_lean_to_one_side_break_the_mirror(scene: Scene) -> None:
    assert not is_mirror_symmetric(scene, np.full((scene.lamp_count, 1), 1.0))


def test_a_sensor_with_more_fibers_on_one_side_has_no_mirror(scene: Scene) -> None:
    lopsided = unchecked(scene, {"fibers": unchecked(scene.fibers, {"left": 7, "right": 9})})
    assert not is_mirror_symmetric(lopsided, nodes(scene))


def test_values_made_from_the_geometry_alone_are_their_own_mirror_image(scene: Scene) -> None:
    bend = 0.7
    poses = fiber_poses(scene, bend)
    phi = nodes(scene)
    beams = poses.directions(phi.T)  # (node, fiber, 3)
    sites = flat_sites(scene)
    sites = np.column_stack([sites, np.zeros(len(sites))]) if sites.shape[1] == 2 else sites
    way = bend_points(scene, sites, bend)[None] - poses.position[:, None]  # (fiber, site, 3)
    towards = np.einsum("jfi,fsi->fjs", beams, way)
    lit = np.einsum("jfi,ki->fjk", beams, facet_normals(scene))
    distance = np.linalg.norm(way, axis=-1)
    pad = towards + distance[:, None]
    cells = pad[..., None] + lit[:, :, None, :]
    shape = (scene.lamp_count, 4, 1, scene.sites.count)
    np.testing.assert_allclose(
        mirror_image(scene, pad.reshape(shape), facets=False), pad.reshape(shape), atol=1e-9
    )
    shape = (*shape, scene.indenter.faces)
    np.testing.assert_allclose(
        mirror_image(scene, cells.reshape(shape), facets=True), cells.reshape(shape), atol=1e-9
    )
