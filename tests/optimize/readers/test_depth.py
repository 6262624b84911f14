"""Slopes are integrated to the depth that they are of, and pixels are put where they look."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import render.preview.lights
from optimize.readers.depth import SeenGrid, integrated
from render.geometry import HeightMap
from render.geometry.height_map import map_lines
from render.preview import Preview
from render.scene import Scene, load_scene


def differences(rows: int, columns: int, step: tuple[float, float]) -> tuple[np.ndarray, list]:
    """Return what takes depths inside a border of zeros to slopes between neighbors."""
    number = -np.ones((rows, columns), dtype=int)
    number[1:-1, 1:-1] = np.arange((rows - 2) * (columns - 2)).reshape(rows - 2, columns - 2)
    lines, pairs = [], []
    for axis, (down, right) in ((0, (0, 1)), (1, (1, 0))):
        for i in range(rows - down):
            for j in range(columns - right):
                ends = number[i, j], number[i + down, j + right]
                if max(ends) < 0:
                    continue
                line = np.zeros((rows - 2) * (columns - 2))
                for end, sign in zip(ends, (-1.0, 1.0), strict=True):
                    if end >= 0:
                        line[end] += sign / step[axis]
                lines.append(line)
                pairs.append((axis, i, j, i + down, j + right))
    return np.array(lines), pairs


def test_integration_is_least_squares_of_the_differences_of_neighbors() -> None:
    slopes, step = np.random.default_rng(1).standard_normal((2, 7, 9)), (0.3, 0.2)
    matrix, pairs = differences(7, 9, step)
    wanted = [(slopes[a, i, j] + slopes[a, k, m]) / 2 for a, i, j, k, m in pairs]
    expected = np.linalg.pinv(matrix) @ np.array(wanted)
    np.testing.assert_allclose(integrated(slopes, step)[1:-1, 1:-1].ravel(), expected, atol=1e-10)


def test_a_balls_slopes_give_its_cap_within_half_a_cell() -> None:
    x, y = np.linspace(-9, 9, 361), np.linspace(-15, 15, 601)
    aside = (x - 2.0) ** 2 + (y[:, None] + 4.0) ** 2
    height = np.sqrt(np.maximum(9.0 - aside, 0.0))
    cap = np.maximum(height - 2.6, 0.0)
    slopes = np.where(cap > 0, -np.stack(np.broadcast_arrays(x - 2.0, y[:, None] + 4.0)), 0.0)
    slopes = slopes / np.where(cap > 0, height, 1.0)
    off = np.abs(integrated(slopes, (0.05, 0.05)) - cap)
    assert off.max() < 0.5 * 0.05
    assert off.max() < 0.02 * cap.max()


@pytest.fixture(autouse=True)
def few_rays(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(render.preview.lights, "RAYS", 20_000)


def two_caps(scene: Scene) -> tuple[HeightMap, np.ndarray, np.ndarray]:
    """Return a skin with no symmetry: a deep ball at +x towards the tip, and a shallow one."""
    x, y = map_lines(scene)
    deep = np.zeros((len(y), len(x)))
    for across, along, radius, depth in ((2.0, 5.0, 3.0, 0.35), (-3.0, -2.0, 2.0, 0.2)):
        aside = (x - across) ** 2 + (y[:, None] - along) ** 2
        deep = np.maximum(deep, np.sqrt(np.maximum(radius**2 - aside, 0)) - radius + depth)
    return HeightMap(deep, scene.pad.width, scene.pad.length), x, y


@pytest.mark.parametrize("name", ["finger20", "gelsight-mini"])
def test_true_normals_of_a_picture_give_the_depth_of_what_is_pressed_in(
    name: str, tmp_path: Path
) -> None:
    scene = load_scene(name)
    skin, x, y = two_caps(scene)
    size = columns, rows = scene.camera.columns, scene.camera.rows
    grid = SeenGrid.of(scene, x, y, size)
    with Preview(scene, cache=tmp_path, imprint=skin) as preview:
        sight = preview.sight(0.0, *size)
    slopes = np.zeros((2, rows * columns))
    slopes[:, sight.pixel] = (sight.facing[:, :2] / sight.facing[:, 2:]).T
    slopes = slopes.reshape(2, rows, columns)[:, ::-1]
    off = 1000.0 * (grid.depth(slopes) - skin.depth)[grid.seen]
    # Micrometers; the caps' rims have corners that no pixel resolves.
    assert np.sqrt((off**2).mean()) < 1.0
    assert np.abs(off).max() < 12.0
    turned = 1000.0 * (grid.depth(slopes[:, ::-1]) - skin.depth)[grid.seen]
    assert np.abs(turned).max() > 100.0


@pytest.mark.parametrize("name", ["finger20", "gelsight-mini"])
def test_the_grid_knows_which_pixel_the_shader_draws_a_place_in(name: str, tmp_path: Path) -> None:
    scene = load_scene(name)
    size = columns, rows = 90, 150 if name == "finger20" else 120
    with Preview(scene, cache=tmp_path) as preview:
        sight = preview.sight(0.0, *size, indented=False)
    number = np.random.default_rng(0).choice(len(sight.pixel), 40)
    x, y = sight.position[number, :2].T
    row, column = np.divmod(sight.pixel[number], columns)
    for place, at in zip(zip(x, y, strict=True), zip(column, row, strict=True), strict=True):
        # Two lines, the first of which is the place.
        lines = (np.array([value, value + 0.1]) for value in place)
        found = SeenGrid.of(scene, *lines, size).place[:, 0, 0]
        np.testing.assert_allclose(found, [at[0], rows - 1 - at[1]], atol=2e-3)
