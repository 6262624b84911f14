"""Closed bodies with a curved upper side, as mesh files: skins whose formula is known."""

from __future__ import annotations

import itertools
import tempfile
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import numpy as np
import trimesh

from render.arrays import Array

RADIUS, MIDDLE = 40.0, np.array([1.5, -2.0])
"""Sphere (mm) of the upper side of `sphere_file`, and where its crown is."""
SIDES, THICKNESS = (20.0, 24.0), 6.0


def sphere_rise(x: Array, y: Array) -> Array:
    """Return the height (mm) of that sphere over its crown."""
    squared = (x - MIDDLE[0]) ** 2 + (y - MIDDLE[1]) ** 2
    return np.asarray(np.sqrt(RADIUS**2 - squared) - RADIUS)


def body_under(
    height: Callable[[Array, Array], Array], sides: tuple[float, float], steps: int
) -> trimesh.Trimesh:
    """Return the block between z = 0 and ``height``, of ``steps`` quads along each side."""
    x, y = (np.linspace(-0.5, 0.5, steps + 1) * side for side in sides)
    grid = np.stack(np.meshgrid(x, y), axis=-1)
    upper = np.concatenate([grid, height(grid[..., 0], grid[..., 1])[..., None]], axis=-1)
    lower = np.concatenate([grid, np.zeros((*grid.shape[:2], 1))], axis=-1)
    number = np.arange((steps + 1) ** 2).reshape(steps + 1, steps + 1)
    below = number + number.size
    faces = []
    for j, i in itertools.product(range(steps), repeat=2):
        for n, way in ((number, 1), (below, -1)):
            a, b, c, d = n[j, i], n[j, i + 1], n[j + 1, i + 1], n[j + 1, i]
            faces.append([[a, b, c][::way], [a, c, d][::way]])
    ring = np.concatenate([number[0, :-1], number[:-1, -1], number[-1, :0:-1], number[:0:-1, 0]])
    for a, b in zip(ring, np.roll(ring, -1), strict=True):
        c, d = b + number.size, a + number.size
        faces.append([[a, c, b], [a, d, c]])
    points = np.concatenate([upper.reshape(-1, 3), lower.reshape(-1, 3)])
    return trimesh.Trimesh(points, np.concatenate(faces), process=False)


@lru_cache(maxsize=1)
def sphere_file() -> Path:
    """Return an STL file of the body under that sphere, kept while the tests run."""
    body = body_under(lambda x, y: THICKNESS + sphere_rise(x, y), SIDES, 96)
    path = Path(_folder().name) / "skin.stl"
    body.export(path)
    return path


@lru_cache(maxsize=1)
def _folder() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="tactilux-skin-")
