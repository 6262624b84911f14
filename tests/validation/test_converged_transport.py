"""Preview and model of finger20 against compiled walks that share next to nothing with either.

The walks (``render.preview.converged``) against closed forms, another walk and themselves; then
colors of random designs, converged and from the shader, against those of the trained model, which
renders of level 2 made. From the command line, with full effort:
``python -m tests.validation.test_converged_transport``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from optimize.scoring import open_model
from render.chebyshev import chebyshev_nodes, interpolation_weights
from render.preview import Preview
from render.preview.diffuser.cache import fiber_end_of, slab_of
from render.preview.diffuser.response import compute_response
from render.progress import Clock
from render.scene import load_scene
from tests.long import LONG
from render.preview.converged.block import bent_block, face_grid
from render.preview.converged.exit_field import exit_field
from render.preview.converged.gathering import gathered, site_points
from render.preview.converged.transport import Effort, task_count, transport_at

SCENE = load_scene("finger20")
DESIGNS = 40
QUICK = Effort(photons=60_000, paths=8_192)
GRID = face_grid(SCENE)
CELL_AREA = np.repeat(2 * GRID.half / GRID.columns, GRID.columns * GRID.rows) * (
    SCENE.pad.thickness / GRID.rows
)


def form_factor(point: np.ndarray, normal: np.ndarray, corners: np.ndarray) -> float:
    """Return Lambert's contour formula: what a polygon gives a small face that sees it."""
    rays = corners - point
    rays = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    after = np.roll(rays, -1, axis=0)
    cross = np.cross(rays, after)
    length = np.linalg.norm(cross, axis=1)
    angle = np.arctan2(length, (rays * after).sum(axis=1))
    return float(abs((angle / length) @ (cross @ normal)) / (2 * np.pi))


def test_black_glowing_faces_give_lambert_s_form_factor() -> None:
    # No reflection at the faces to the air and a layer that absorbs all: direct light alone.
    block = bent_block(SCENE, 0.0, pressed=False)._replace(index=1.0, alpha=0.0, sigma_a=1e6)
    site, points = 7, 32_768
    found = gathered(site_points(SCENE, 0.0, site, None, points), block, GRID, 135)
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


def test_the_layer_passes_as_much_power_as_the_other_walk_says() -> None:
    phi = np.array([np.pi / 2 - 0.5, np.pi / 2, np.pi / 2 + 0.5])
    block = bent_block(SCENE, 0.0, pressed=False)
    field = exit_field(SCENE, 0.0, 4, phi, block, GRID, 40_000)
    power = np.einsum("ctn,c->tn", field, np.sqrt(np.pi * CELL_AREA))[0]
    other = compute_response(slab_of(SCENE), fiber_end_of(SCENE), rays=40_000, phi=phi).power(phi)
    # The other layer is endless; 1.5 % noise each.
    np.testing.assert_allclose(power, other, rtol=0.06)


def test_a_lamp_gives_the_same_bits_again() -> None:
    block = bent_block(SCENE, np.pi / 2, pressed=False)
    phi = np.array([1.0, 2.0])
    one, two = (exit_field(SCENE, np.pi / 2, 3, phi, block, GRID, 4_000) for _ in range(2))
    assert (one == two).all()


def test_bend_zero_is_the_limit_of_small_bends() -> None:
    flat, bent = (
        gathered(
            site_points(SCENE, bend, 7, None, 2_000),
            bent_block(SCENE, bend, pressed=True), GRID, 135,
        ).terms.sum()
        for bend in (0.0, 1e-7)
    )  # fmt: skip
    assert bent == pytest.approx(flat, rel=0.05)


@dataclass(frozen=True)
class Deviation:
    """Of colors of facets from the model's: rms over rms, and the ratio of the sums."""

    rms: float
    ratio: float


def deviations(bend: float, effort: Effort) -> tuple[Deviation, Deviation]:
    """Return those of converged transport and of the shader's, over random designs."""
    rng = np.random.default_rng(0)
    phi = rng.uniform(0.0, np.pi, (DESIGNS, SCENE.lamp_count))
    power = np.eye(3)[rng.integers(0, 3, phi.shape)]
    model = open_model(SCENE)
    assert model.level == "surrogate"
    known = model.run(phi, power, np.array([bend]))["counts"][:, 0]
    below = (known.max(axis=-1) < 250.0)[..., None]  # the others saturate

    def deviation(nodes: np.ndarray, cells: np.ndarray) -> Deviation:
        light = np.einsum("dfj,fjsk->dfsk", interpolation_weights(nodes, phi), cells)
        colors = model.exposure * np.einsum("dfsk,dfc->dskc", light, power)
        apart = (colors - known) * below
        return Deviation(
            float(np.sqrt((apart**2).sum() / ((known * below) ** 2).sum())),
            float((colors * below).sum() / (known * below).sum()),
        )

    few, many = (chebyshev_nodes(count, 0.0, np.pi) for count in (13, 33))
    cells = transport_at(SCENE, bend, few, effort, Clock(task_count(SCENE), None))
    with Preview(SCENE) as preview:
        shader, _ = preview.transport(many, np.array([bend]))
    return deviation(few, cells[..., :-1]), deviation(many, shader[:, :, 0])


@pytest.mark.parametrize("degrees", [0.0, 45.0, 90.0] if LONG else [90.0])
def test_renders_agree_with_converged_transport_better_than_with_the_shader(degrees: float) -> None:
    converged, shader = deviations(np.radians(degrees), Effort() if LONG else QUICK)
    assert converged.rms < (0.018 if LONG else 0.03)
    assert converged.ratio == pytest.approx(1.0, abs=0.015)
    assert converged.rms < shader.rms


if __name__ == "__main__":
    for angle in SCENE.bending.angles:
        for name, found in zip(("converged", "shader"), deviations(angle, Effort()), strict=True):
            print(f"{np.degrees(angle):3.0f} deg, {name}: {found.rms:.2%} rms, {found.ratio:.4f}")
