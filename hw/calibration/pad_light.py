"""The untouched pad under one fiber at a time, rendered by the reference for any material.

The transport tables know the sites alone; photographs show the whole pad. So the pad is cut into
cells that take the sites' place in the path sampler, each of them into blocks that are its targets:
one Monte Carlo run renders all fibers of a bend at once. All blocks of a cell share their light
subpaths, so their errors hang together; those of cells do not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hw.camera.projection import pad_positions
from render.arrays import Array
from render.progress import Clock, OnProgress
from tactilux import Scene

if TYPE_CHECKING:
    from render.cells.cell_sampler import Targets

CELL = 2.0
"""Least side (mm) of the cells that share light subpaths."""
BLOCKS = 4
"""Blocks along each side of a cell: half a millimeter, as the points of reference lines."""
LANES, MIN_PASSES = 16384, 16
MAX_COLUMNS, MAX_ROWS = 32, 64
REPLICATES = 8


@dataclass(frozen=True, eq=False)
class PadLight:
    """Radiance per unit power on a grid of blocks, 1/(mm^2 sr).

    Arguments:
        cell: side of a cell in mm.
        blocks: along each side of a cell.
        radiance: ``(bend, fiber, row, column)`` in blocks, row 0 at the base, column 0 at the least
            x; NaN where the camera sees nothing, and for fibers that were not lit.
        error: its standard error, the same shape.
    """

    cell: float
    blocks: int
    radiance: Array
    error: Array

    def at(self, bend: int, fiber: int, position: Array) -> tuple[Array, Array]:
        """Return radiance and error ``(...)`` at flat positions ``(..., 2)`` mm, NaN where unseen.

        Radiance is linear between the middles of blocks.
        """
        from scipy.ndimage import map_coordinates

        place = np.moveaxis(self._place(position), -1, 0)
        seen = np.isfinite(place).all(axis=0)
        safe = np.where(seen, place, 0.0)
        found = [
            map_coordinates(field[bend, fiber], safe, order=order, mode="nearest")
            for field, order in ((self.radiance, 1), (self.error, 0))
        ]
        radiance, error = (np.where(seen, values, np.nan) for values in found)
        return radiance, error

    @property
    def block(self) -> float:
        """Side of a block in mm."""
        return self.cell / self.blocks

    def positions(self) -> Array:
        """Return the middles of the blocks, flat x, y in mm, ``(row, column, 2)``."""
        y, x = (self.block * (np.arange(n) - (n - 1) / 2) for n in self.radiance.shape[2:])
        return np.stack(np.meshgrid(x, y), axis=-1)

    def cell_of(self, position: Array) -> Array:
        """Return the number of the cell ``(...)`` that flat positions ``(..., 2)`` mm lie in."""
        return self._number(position, self.blocks)

    def part_of(self, position: Array) -> Array:
        """Return the number of the part, half a cell wide, that flat positions ``(..., 2)`` lie in.

        Their errors are nearly independent, though they share light subpaths.
        """
        return self._number(position, max(1, self.blocks // 2))

    def _number(self, position: Array, side: int) -> Array:
        """Return the number of the square, ``side`` blocks wide, that positions lie in."""
        place = np.nan_to_num(self._place(position)).round() // side
        return np.asarray(place[..., 0] * (self.radiance.shape[3] // side) + place[..., 1])

    def _place(self, position: Array) -> Array:
        """Return row and column ``(..., 2)`` in blocks, whole numbers in their middles."""
        size = np.array(self.radiance.shape[:1:-1])
        return np.asarray((position / self.block + size / 2 - 0.5)[..., ::-1])


def render_pad_light(
    scene: Scene,
    phi: Array,
    bends: Array,
    lit: Sequence[Sequence[int]],
    *,
    samples: int,
    seed: int,
    around: Array | None = None,
    progress: OnProgress | None = None,
) -> PadLight:
    """Render the untouched pad under the fibers that are ``lit``.

    Arguments:
        scene: with the material that is rendered.
        phi: ``(fiber,)`` rad.
        bends: ``(bend,)`` rad.
        lit: numbers of the fibers that are rendered, for each bend.
        samples: light paths per rendered fiber and cell, on average.
        seed: of the paths.
        around: ``(fiber, point, 2)`` flat positions (mm; NaN for none) that matter: cells of a
            fiber that neither hold one nor touch such a cell are left out. All matter by default.
        progress: called every few seconds.

    Raises:
        RenderError: a path returned a value that is not finite.
    """
    from render.cells.cell_sampler import CellSampler
    from render.reference import VARIANT, mitsuba
    from render.sampling.monte_carlo import MonteCarlo

    mitsuba(VARIANT)
    cut = _cut(scene)
    cells = cut.sites
    rows, columns = cells.rows * BLOCKS, cells.columns * BLOCKS
    shape = (len(bends), scene.fibers.count, rows, columns)
    radiance, error = np.full(shape, np.nan), np.full(shape, np.nan)
    wanted = _wanted(cut, around)
    pairs = [wanted & np.isin(np.arange(scene.fibers.count), on) for on in lit]
    passes = [_passes(samples * int(pair.sum())) for pair in pairs]
    clock = Clock(sum(number * lanes for number, lanes in passes), progress)
    for index, bend in enumerate(bends):
        if not pairs[index].any():
            continue
        targets = _blocks(cut, float(bend))
        number, lanes = passes[index]
        pad_cells = CellSampler(cut, phi[:, None], float(bend), False, targets, pairs[index])
        run = MonteCarlo(pad_cells, lanes, REPLICATES, seed * len(bends) + index)
        for _ in range(number):
            run.sample(1)
            clock.tick(lanes)
        # (replicate, fiber, cell row, cell column, row, column), where something was rendered.
        found = run.estimate().reshape(
            REPLICATES, scene.fibers.count, cells.rows, cells.columns, BLOCKS, BLOCKS
        )
        seen = np.diff(targets.offset).reshape(cells.rows, cells.columns, BLOCKS, BLOCKS) > 0
        lit_here = pairs[index].T.reshape(-1, cells.rows, cells.columns, 1, 1)
        found = np.where(lit_here & seen, found, np.nan)
        found = found.transpose(0, 1, 2, 4, 3, 5).reshape(REPLICATES, -1, rows, columns)
        radiance[index] = found.mean(axis=0)
        error[index] = found.std(axis=0, ddof=1) / np.sqrt(REPLICATES)
    return PadLight(cells.spacing, BLOCKS, radiance, error)


def _cut(scene: Scene) -> Scene:
    """Return the scene whose sites are the middles of the cells."""
    pad = scene.pad
    side = max(CELL, pad.width / MAX_COLUMNS, pad.length / MAX_ROWS)
    cells = scene.sites.model_copy(
        update={
            "columns": int(np.ceil(pad.width / side - 1e-9)),
            "rows": int(np.ceil(pad.length / side - 1e-9)),
            "spacing": side,
            "centre_x": 0.0,
            "centre_y": 0.0,
        }
    )
    return scene.model_copy(update={"sites": cells})


def _wanted(cut: Scene, around: Array | None) -> NDArray[np.bool_]:
    """Return which cells of which fibers matter, ``(cell, fiber)``."""
    from scipy.ndimage import binary_dilation

    cells, fibers = cut.sites, cut.fibers.count
    wanted = np.ones((fibers, cells.rows, cells.columns), dtype=np.bool_)
    if around is not None:
        place = around / cells.spacing + np.array([cells.columns, cells.rows]) / 2
        for fiber, points in enumerate(place):
            column, row = np.floor(points[np.isfinite(points).all(axis=1)]).astype(np.int64).T
            holds = np.zeros(wanted.shape[1:], dtype=np.bool_)
            holds[np.clip(row, 0, cells.rows - 1), np.clip(column, 0, cells.columns - 1)] = True
            wanted[fiber] = binary_dilation(holds, np.ones((3, 3)))
    return wanted.reshape(fibers, -1).T


def _blocks(cut: Scene, bend: float) -> Targets:
    """Return the pixels of every block, numbered by cell and then by row and column within it."""
    from render.cells.cell_sampler import Targets

    cells = cut.sites
    position = pad_positions(cut, bend, cut.camera.rows, cut.camera.columns).reshape(-1, 2)
    size = np.array([cells.columns, cells.rows]) * BLOCKS
    block = np.floor(position / (cells.spacing / BLOCKS) + size / 2)
    pixel = np.nonzero(np.all((block >= 0) & (block < size), axis=1))[0]
    column, row = block[pixel].astype(np.int64).T
    cell = row // BLOCKS * cells.columns + column // BLOCKS
    target = (cell * BLOCKS + row % BLOCKS) * BLOCKS + column % BLOCKS
    counts = np.bincount(target, minlength=cells.count * BLOCKS**2)
    return Targets(
        pixel[np.argsort(target, kind="stable")], np.concatenate([[0], np.cumsum(counts)])
    )


def _passes(paths: int) -> tuple[int, int]:
    """Return how many passes of how many lanes make ``paths``."""
    lanes = LANES
    while lanes > 64 and paths < MIN_PASSES * lanes:
        lanes //= 2
    return max(1, round(paths / lanes)), lanes
