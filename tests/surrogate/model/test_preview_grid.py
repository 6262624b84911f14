"""The preview on Chebyshev nodes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from render.errors import TableError
from render.preview import Preview
from render.scene import Scene, load_scene
from surrogate.model.preview_grid import (
    FLOOR,
    PreviewGrid,
    grid_from_transport,
    grid_nodes,
    interpolation_error,
)


def test_the_grid_is_the_preview_at_its_nodes(scene: Scene, grid: PreviewGrid) -> None:
    with Preview(scene) as preview:
        transport, background = preview.transport(grid.phi[2:4], grid.bends[1:2])
    found = np.exp(grid.evaluate(grid.phi[2:4], grid.bends[1:2]))
    np.testing.assert_allclose(found[..., :-1], transport, rtol=1e-5)
    np.testing.assert_allclose(found[..., -1], background, rtol=1e-5)


def test_between_the_nodes_it_is_off_by_little(scene: Scene, grid: PreviewGrid) -> None:
    error = interpolation_error(scene, grid)
    assert error.median < 0.01
    assert error.p95 < 0.05


def test_the_scenes_own_bends_are_nodes_of_the_default_grid() -> None:
    finger = load_scene("finger20")
    _, bends = grid_nodes(finger, 11, 9)
    for angle in finger.bending.angles:
        assert np.abs(bends - angle).min() < 1e-12


def test_a_scene_with_one_bend_gets_one_node(make_scene: Callable[..., Scene]) -> None:
    one = make_scene(bending={"angles": {"value": [30.0], "unit": "deg", "source": "test"}})
    _, bends = grid_nodes(one, 5, 7)
    assert bends.tolist() == [np.radians(30.0)]


def test_black_cells_hold_the_floor_and_are_counted() -> None:
    transport = np.ones((1, 2, 1, 1, 3))
    transport[0, 0, 0, 0, 1] = 0.0
    grid = grid_from_transport(transport, np.ones((1, 2, 1, 1)), np.array([0.0, 1.0]), np.zeros(1))
    assert grid.floored == 1
    assert grid.log_transport.min() == pytest.approx(np.log(FLOOR))


def test_a_black_preview_is_refused() -> None:
    with pytest.raises(TableError, match=r"the preview is black: .* coating\.albedo"):
        grid_from_transport(
            np.zeros((1, 1, 1, 1, 3)), np.zeros((1, 1, 1, 1)), np.zeros(1), np.zeros(1)
        )
    light = np.ones((2, 1, 1, 1, 3))
    light[1, 0, 0, 0, 2] = np.nan
    with pytest.raises(TableError, match="lamp 1 is not finite"):
        grid_from_transport(light, np.ones((2, 1, 1, 1)), np.zeros(1), np.zeros(1))
