"""Cells of a flat pad that is unfolded over its walls (image method), and ways that end in them.

A *cell* is numbered per axis: 0 the pad itself, 1 its image in the upper wall, -1 that in the lower
one, 2 the image of 1, and so on. A *way* is the face that light enters through and the cell where
that happens. Sides are numbered by axis, the lower one first.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from render.arrays import Array
from render.scene import FACES, OUTWARD

CELL_MAX = 2
"""Cells beyond it, in either direction, are left to camera subpaths that meet the lamp."""
CELLS = 2 * CELL_MAX + 1
DOWN = 5
"""Cells in z, 0 to -4: the lower face may reflect, and in turn with it the top of a clear rim."""
DEPTHS = 14
"""Numbers of ways along z: over a bond there are more."""
CODES = len(FACES) * CELLS**2 * DEPTHS
"""Ways, numbered by face and cell in x, y and z."""


def code_of(counts: mi.Vector3u, up: mi.Vector3u, n: mi.Normal3f, depth: mi.UInt32) -> mi.UInt32:
    """Return the number of the way that ends ``depth`` cells down, CODES where it has none."""
    face = dr.select(n.z < -0.5, mi.UInt32(4), 0)  # as in render.scene.FACES
    face = dr.select(n.y > 0.5, 1, dr.select(n.x > 0.5, 2, dr.select(n.y < -0.5, 3, face)))
    x, y = (dr.select(up[i] > 0, CELL_MAX + counts[i], CELL_MAX - counts[i]) for i in range(2))
    number = ((face * CELLS + x) * CELLS + y) * DEPTHS + depth
    return dr.select((counts.x <= CELL_MAX) & (counts.y <= CELL_MAX), number, CODES)


@dataclass(frozen=True)
class LampWay:
    """The ``face`` that light enters through and the ``cells`` (x, y, z) where that happens."""

    face: int
    cells: tuple[int, int, int]

    @property
    def code(self) -> int:
        """Number among CODES."""
        x, y, z = self.cells
        return ((self.face * CELLS + x + CELL_MAX) * CELLS + y + CELL_MAX) * DEPTHS - z


def wall_reflections(cells: tuple[int, int, int]) -> NDArray[np.int64]:
    """Return how often each side reflects on the way to a cell, ``(axis and side,)``."""
    counts = np.zeros((3, 2), dtype=np.int64)
    for axis, cell in enumerate(cells):
        first = abs(cell) - abs(cell) // 2
        counts[axis, int(cell > 0)] = first
        counts[axis, int(cell <= 0)] = abs(cell) - first
    return counts.ravel()


def box_image(low: Array, high: Array, cells: tuple[int, int, int]) -> tuple[Array, Array]:
    """Return ``sign`` and ``shift`` (mm) of a cell: the image of p is sign * p + shift."""
    cell, size = np.array(cells), high - low
    odd = cell % 2 != 0
    return np.where(odd, -1.0, 1.0), np.where(odd, 2 * low + (cell + 1) * size, cell * size)


def side_of(face: int) -> int:
    """Return twice the axis of a face, and one more for the upper side."""
    axis = int(np.abs(OUTWARD[face]).argmax())
    return 2 * axis + int(OUTWARD[face][axis] > 0)


def travels_up(way: LampWay) -> bool:
    """Return whether the unfolded line goes up the axis of the face that it crosses."""
    side = side_of(way.face)
    cell = way.cells[side // 2]
    upper = side % 2 == 1
    return upper if cell % 2 == 0 else not upper
