"""Inputs of the residual network."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch

from render.geometry import fiber_edges, mirror_twins
from render.scene import Scene, load_scene
from surrogate.model.checker_module import PreviewTable
from surrogate.model.features import FEATURE_NAMES, CellFeatures
from surrogate.model.preview_grid import PreviewGrid, draw_grid


def _inputs(scene: Scene, grid: PreviewGrid, phi: np.ndarray) -> torch.Tensor:
    directions = torch.as_tensor(phi, dtype=torch.float32)
    bend = torch.linspace(0.0, 1.5, 4).expand(len(phi), -1)
    x = CellFeatures(scene, grid)(directions, bend, PreviewTable(grid)(directions, bend))
    return x.movedim(0, -1)


def test_inputs_are_finite_and_of_order_one(scene: Scene, grid: PreviewGrid) -> None:
    phi = np.linspace(0, np.pi, 9)[:, None].repeat(scene.lamp_count, axis=1)
    x = _inputs(scene, grid, phi)
    assert x.shape == (9, scene.lamp_count, 4, scene.sites.count, len(FEATURE_NAMES))
    assert x.isfinite().all()
    assert x.abs().max() < 6.0


def test_mirror_twins_have_the_same_inputs(scene: Scene, grid: PreviewGrid) -> None:
    rng = np.random.default_rng(0)
    phi = rng.uniform(0, np.pi, (1, scene.lamp_count))
    twin = phi[:, mirror_twins(scene).twin]
    tip = np.array([edge == "tip" for edge in fiber_edges(scene)])
    twin[:, tip] = np.pi - twin[:, tip]
    sites = np.arange(scene.sites.count).reshape(scene.sites.rows, scene.sites.columns)
    here = _inputs(scene, grid, phi)
    there = _inputs(scene, grid, twin)[:, mirror_twins(scene).twin.copy()]
    there = there[:, :, :, sites[:, ::-1].ravel().copy()]
    # The drawn preview itself is symmetric to a few per mille only.
    np.testing.assert_allclose(here, there, atol=0.05)
    np.testing.assert_allclose(here[..., :15], there[..., :15], atol=1e-5)


def test_a_scene_with_one_bend_has_a_constant_bend_input(
    make_scene: Callable[..., Scene],
) -> None:
    flat = make_scene(
        bending={"angles": {"value": [0.0], "unit": "deg", "source": "test"}},
    )
    grid = PreviewGrid(
        np.random.default_rng(0).normal(size=(8, 3, 1, 6, 7)),
        np.array([0.0, 1.0, np.pi]),
        np.array([0.0]),
        0,
    )
    phi = torch.full((2, 8), 1.0)
    bend = torch.zeros(2, 1)
    x = CellFeatures(flat, grid)(phi, bend, PreviewTable(grid)(phi, bend))
    assert (x[FEATURE_NAMES.index("bend")] == 0).all()


def test_the_direction_of_a_lamp_that_cannot_turn_is_no_input() -> None:
    digit = load_scene("digit")
    grid = draw_grid(digit, 11, 1)
    assert grid.phi.tolist() == [np.pi / 2]
    turned, straight = (_inputs(digit, grid, np.full((1, 3), phi)) for phi in (0.3, np.pi / 2))
    assert torch.equal(turned, straight)
    names = [FEATURE_NAMES.index(name) for name in ("cos phi", "sin phi")]
    assert straight[0, :, 0, 0, names].tolist() == [[0.0, 1.0]] * 3
