"""Light that leaves the layer and light followed backwards: closed forms and another walk."""

from __future__ import annotations

import numpy as np
import pytest

from render.preview.converged.block import bent_block, cell_areas, face_grid
from render.preview.converged.exit_field import exit_field
from render.preview.converged.gathering import gathered, site_points
from render.preview.diffuser.cache import fiber_end_of, slab_of
from render.preview.diffuser.response import compute_response
from render.scene import load_scene

SCENE = load_scene("finger20")
GRID = face_grid(SCENE)
CELL_AREA = cell_areas(GRID)


def form_factor(point: np.ndarray, normal: np.ndarray, corners: np.ndarray) -> float:
    """Return Lambert's contour formula: what a polygon gives a small face that sees it."""
    rays = corners - point
    rays = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    after = np.roll(rays, -1, axis=0)
    cross = np.cross(rays, after)
    length = np.linalg.norm(cross, axis=1)
    angle = np.arctan2(length, (rays * after).sum(axis=1))
    return float(abs((angle / length) @ (cross @ normal)) / (2 * np.pi))


@pytest.mark.slow
def test_black_glowing_faces_give_lambert_s_form_factor() -> None:
    # No reflection at the faces to the air and a layer that absorbs all: direct light alone.
    block = bent_block(SCENE, 0.0, pressed=False)._replace(
        index=1.0, alpha=np.zeros(12), sigma_a=1e6
    )
    site, points = 7, 32_768
    found = gathered(site_points(SCENE, 0.0, site, None, points), block, GRID, 135).whole
    uniform = found.terms.reshape(len(CELL_AREA), -1)[:, 0] @ np.sqrt(np.pi * CELL_AREA)
    x, y, t = SCENE.pad.width / 2, SCENE.pad.length / 2, SCENE.pad.thickness
    center = np.array([SCENE.sites.centre_x, SCENE.sites.centre_y, t])
    faces = [
        [[-x, -y, 0], [-x, y, 0], [-x, y, t], [-x, -y, t]],
        [[x, -y, 0], [x, y, 0], [x, y, t], [x, -y, t]],
        [[-x, y, 0], [x, y, 0], [x, y, t], [-x, y, t]],
    ]
    exact = sum(form_factor(center, np.array([0, 0, -1.0]), np.array(face)) for face in faces)
    # The spot is 0.4 mm wide, which curvature of the irradiance makes a few thousandths.
    assert uniform == pytest.approx(exact, rel=0.02)


@pytest.mark.slow
def test_the_layer_passes_as_much_power_as_the_other_walk_says() -> None:
    phi = np.array([np.pi / 2 - 0.5, np.pi / 2, np.pi / 2 + 0.5])
    block = bent_block(SCENE, 0.0, pressed=False)
    field = exit_field(SCENE, 0.0, 4, phi, block, GRID, 40_000).whole
    power = np.einsum("ctn,c->tn", field, np.sqrt(np.pi * CELL_AREA))[0]
    other = compute_response(slab_of(SCENE), fiber_end_of(SCENE), rays=40_000, phi=phi).power(phi)
    # The other layer is endless; 1.5 % noise each.
    np.testing.assert_allclose(power, other, rtol=0.06)


def test_a_lamp_gives_the_same_bits_again() -> None:
    block = bent_block(SCENE, np.pi / 2, pressed=False)
    phi = np.array([1.0, 2.0])
    one, two = (exit_field(SCENE, np.pi / 2, 3, phi, block, GRID, 4_000).whole for _ in range(2))
    assert (one == two).all()


def test_bend_zero_is_the_limit_of_small_bends() -> None:
    flat, bent = (
        gathered(
            site_points(SCENE, bend, 7, None, 2_000),
            bent_block(SCENE, bend, pressed=True), GRID, 135,
        ).whole.terms.sum()
        for bend in (0.0, 1e-7)
    )  # fmt: skip
    assert bent == pytest.approx(flat, rel=0.05)
