"""Cells of the unfolded pad in which lamps that are cast into it are seen (image method).

A cell is numbered per axis, as in ``render.cells.clear.unfolded_cells``: 0 the pad itself, 1 its
image in the upper wall, -1 that in the lower one, 2 the image of 1, and so on. Over a window of
another index z says how light came instead: straight (0), over the bond (-1), through it to a lamp
in the pad (from -``THROUGH_BOND`` - 1 on) or to one in the window (from -``IN_WINDOW`` on).
"""

from __future__ import annotations

from typing import TypeVar

import drjit as dr
import mitsuba as mi
import numpy as np

from render.cells.mirror_images import mirror_faces
from render.geometry import LOWER
from render.scene import FACES, Scene

Integers = TypeVar("Integers", np.ndarray, "mi.Int32")
"""Of numpy or of Dr.Jit: one formula numbers both."""

CELL_MAX = 40
"""Cells up to it, in either direction, are in the table; those beyond are far."""
CELLS = 2 * CELL_MAX + 1
UP, DOWN = 2, 7
"""Cells in z, 2 to -7: the lower face may reflect, and in turn with it the top of a rim."""
THROUGH_BOND, TURNS, NEAR_TURNS = 3, 14, 4
"""Cells in z by which those lie lower that are seen through the bond of pad and window, by how
often the lower face has reflected; the most of that, and up to where it matters far away."""
IN_WINDOW = THROUGH_BOND + TURNS + 1
"""Cells in z by which those of lamps in the window lie lower, by how often a face has reflected."""
DEPTHS = UP + IN_WINDOW + TURNS
"""Numbers of cells in z."""
RIM_CELL_MAX = 20
"""Cells in x and y where the top of a rim has reflected, and it or the lower face twice."""
RIM_FAR = 0.2
"""What of the far cells are those where it has reflected."""
RIM_SHARE = 0.05
"""What of the coating sees those, about: the top of a rim is narrow."""
CODES = DEPTHS * CELLS**2
"""Near cells, numbered in the table."""
ORIGIN, STEP = 1 << 11, 1 << 12
"""x and y of a cell are packed as so much more, so much apart; more than ``RING_MAX`` is none."""
AIMED_CELL_MAX = 1
"""Cells up to here are known to ``LampAim``, for facets."""


def met_until(cell: mi.Int32) -> tuple[mi.Int32, mi.Int32]:
    """Return how often the lower and the upper face of an axis are met on the way to a cell."""
    times = dr.abs(cell)
    # The side that the way goes to is the first to reflect.
    upper = (times + dr.select(cell > 0, 1, 0)) // 2
    return times - upper, upper


def cast_in(scene: Scene) -> np.ndarray:
    """Return which lamps are in the silicone, or in the window, ``(lamp,)``."""
    return np.array([lamp.solid is not None for lamp in scene.placed_lamps()])


def has_lamp_images(scene: Scene) -> bool:
    """Return whether a flat pad has lamps that its walls show over and over."""
    return bool(cast_in(scene).any()) and not aimed_cells(scene, lamp_cells(scene)).all()


def lamp_cells(scene: Scene) -> np.ndarray:
    """Return the cells ``(cell, 3)`` of the table: all that the coating may see but far ones."""
    mirrors = dict(zip(FACES, mirror_faces(scene), strict=True))
    reach = [
        CELL_MAX if mirrors[low] and mirrors[high] else AIMED_CELL_MAX
        for low, high in (("left", "right"), ("base", "tip"))
    ]
    below = mirrors[FACES[LOWER]]
    # The top of a rim is a face of the pad beside the skin.
    strip = bool(scene.box.layered.any()) and scene.pad.roughness == 0.0
    highest, lowest = (UP, -DOWN) if strip else (0, -1)
    levels = list(range(lowest, highest + 1) if below else range(min(highest, 1) + 1))
    bonded = scene.window_refracts
    if bonded:
        turns = range(1, TURNS + 1) if below else ()
        solids = {lamp.solid for lamp in scene.placed_lamps()}
        levels = [-1, 0, *(-THROUGH_BOND - turn for turn in turns)] if solids - {"window"} else []
        if "window" in solids:
            levels += [-IN_WINDOW - turn for turn in range(TURNS if below else 1)]
    reaching = {-2, -1, 0, 1}
    if bonded:
        few = range(NEAR_TURNS + 1)
        reaching = {-1, 0, *(-of - turn for of in (THROUGH_BOND, IN_WINDOW) for turn in few)}
    found = [
        (x, y, z)
        for x in range(-reach[0], reach[0] + 1)
        for y in range(-reach[1], reach[1] + 1)
        for z in levels
        if max(abs(x), abs(y)) <= (CELL_MAX if z in reaching else RIM_CELL_MAX)
        and (x, y, z) != (0, 0, 0)
    ]
    singles = {(0, False): "left", (0, True): "right", (1, False): "base", (1, True): "tip"}
    kept = [
        cell
        for cell in found
        if all(mirrors[singles[axis, cell[axis] > 0]] for axis in (0, 1) if abs(cell[axis]) == 1)
    ]
    return np.array(kept, dtype=np.int64).reshape(-1, 3)


def far_levels(scene: Scene, cells: np.ndarray) -> dict[int, float]:
    """Return the z that far cells have as the last of the table do, and what of them each has."""
    last = cells[np.abs(cells[:, :2]).max(axis=1) == CELL_MAX]
    rim = over_a_rim(scene, last)
    plain, over = np.unique(last[~rim, 2]).tolist(), np.unique(last[rim, 2]).tolist()
    share = RIM_FAR if over else 0.0
    levels = {z: (1.0 - share) / len(plain) for z in plain}
    return levels | {z: share / len(over) for z in over}


def aimed_cells(scene: Scene, cells: np.ndarray) -> np.ndarray:
    """Return which cells ``(cell, 3)`` are known to ``LampAim``."""
    near = (np.abs(cells[:, :2]) <= AIMED_CELL_MAX).all(axis=1)
    if scene.window_refracts:
        # Over the bond it aims over one wall at most, and over the lower face once.
        z = cells[:, 2]
        near &= (z != -1) | (cells[:, :2] == 0).all(axis=1)
        near &= (z >= -THROUGH_BOND - 1) | ((z <= -IN_WINDOW) & (z >= -IN_WINDOW - 1))
    return np.asarray(near & ~over_a_rim(scene, cells))


def over_a_rim(scene: Scene, cells: np.ndarray) -> np.ndarray:
    """Return which cells ``(cell, 3)`` are seen over the top of a rim."""
    if scene.window_refracts:
        return np.zeros(len(cells), dtype=bool)
    return np.asarray((cells[:, 2] > 0) | (cells[:, 2] < -1))


def code_of(x: Integers, y: Integers, z: Integers) -> Integers:
    """Return the numbers of near cells in the table."""
    return ((x + CELL_MAX) * CELLS + y + CELL_MAX) * DEPTHS + UP - z


def packed(x: Integers, y: Integers, z: Integers) -> Integers:
    """Return cells as images, signed."""
    return ((x + ORIGIN) * STEP + y + ORIGIN) * DEPTHS + UP - z
