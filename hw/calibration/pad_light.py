"""The untouched pad under one fiber at a time, rendered by the reference for any material.

The transport tables know the sites alone; photographs show the whole pad. So the pad is cut into
cells that take the sites' place in the path sampler, each of them into blocks that are its targets:
one Monte Carlo run renders all fibers of a bend at once. All blocks of a cell share their light
subpaths, so their errors hang together; those of cells do not.

Renders of materials that fill the range serve every rig of one design: they depend on the scene's
geometry, the fibers' directions and the bends, not on photographs. So they are kept in the user's
cache, one file each, and interrupted work goes on where it stood.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hw.calibration.log_ratio import LogRatios, log_ratios
from hw.calibration.reference_lines import Setup, frame_positions
from hw.camera.projection import pad_positions
from render.arrays import Array
from render.files import read_or_drop, write_npz
from render.progress import Clock, OnProgress, Progress
from render.scene import unchecked
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
VERSION, FIRST_SEED = 1, 5000
"""Of the renders that are kept."""


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
        radiance, error = (
            map_coordinates(field, np.where(seen, place, 0.0), order=order, mode="nearest")
            for field, order in ((self.radiance[bend, fiber], 1), (self.error[bend, fiber], 0))
        )
        return np.where(seen, radiance, np.nan), np.where(seen, error, np.nan)

    def log_ratios(self, bend: int, fiber: int, position: Array, log_light: Array) -> LogRatios:
        """Return what it says about a model of one fiber's light at its lines.

        One sample comes from each part, half a cell wide: errors of parts are nearly independent,
        though they share light subpaths.

        ``position`` ``(point, 2)`` is mm on the flat pad; ``log_light`` ``(point,)`` of the model
        is NaN where nothing is wanted.
        """
        parts = self.square_of(position, self.blocks // 2)
        return log_ratios(frame_positions(), parts, *self.at(bend, fiber, position), log_light)

    @property
    def block(self) -> float:
        """Side of a block in mm."""
        return self.cell / self.blocks

    def positions(self) -> Array:
        """Return the middles of the blocks, flat x, y in mm, ``(row, column, 2)``."""
        y, x = (self.block * (np.arange(n) - (n - 1) / 2) for n in self.radiance.shape[2:])
        return np.stack(np.meshgrid(x, y), axis=-1)

    def square_of(self, position: Array, side: int) -> Array:
        """Return the number of the square, ``side`` blocks wide, of positions ``(..., 2)`` mm.

        Cells are `blocks` wide, and numbered row by row from the base.
        """
        place = np.nan_to_num(self._place(position)).round() // side
        return np.asarray(place[..., 0] * (self.radiance.shape[3] // side) + place[..., 1])

    def _place(self, position: Array) -> Array:
        """Return row and column ``(..., 2)`` in blocks, whole numbers in their middles."""
        size = np.array(self.radiance.shape[:1:-1])
        return np.asarray((position / self.block + size / 2 - 0.5)[..., ::-1])


def render_pad_light(
    setup: Setup,
    lit: Sequence[Sequence[int]],
    *,
    samples: int,
    seed: int,
    around: Array,
    progress: OnProgress | None = None,
) -> PadLight:
    """Render the untouched pad under the fibers that are ``lit``.

    There are ``samples`` light paths per rendered fiber and cell on average. ``around`` ``(fiber,
    point, 2)`` are the flat positions (mm; NaN for none) that matter: cells of a fiber that neither
    hold one nor touch such a cell are left out.

    Raises:
        RenderError: a path returned a value that is not finite.
    """
    from render.cells.cell_sampler import CellSampler
    from render.reference import VARIANT, mitsuba
    from render.sampling.monte_carlo import MonteCarlo

    mitsuba(VARIANT)
    cut, fibers = _cut(setup.scene), setup.scene.lamp_count
    cells = cut.sites
    rows, columns = cells.rows * BLOCKS, cells.columns * BLOCKS
    wanted = _wanted(cut, around)
    pairs = [wanted & np.isin(np.arange(fibers), on) for on in lit]
    passes = [_passes(samples * int(pair.sum())) for pair in pairs]
    clock = Clock(sum(number * lanes for number, lanes in passes), progress)
    found = np.full((REPLICATES, len(pairs), fibers, rows, columns), np.nan)
    for index, (bend, pair, (number, lanes)) in enumerate(
        zip(setup.bends, pairs, passes, strict=True)
    ):
        if not pair.any():
            continue
        targets = _blocks(cut, float(bend))
        pad_cells = CellSampler(cut, setup.phi[:, None], float(bend), False, targets, lit=pair)
        run = MonteCarlo(pad_cells, lanes, REPLICATES, seed * len(pairs) + index)
        for _ in range(number):
            run.sample(1)
            clock.tick(lanes)
        # From (replicate, fiber, cell row, cell column, row, column), where something was rendered.
        shape = (-1, cells.rows, cells.columns, BLOCKS, BLOCKS)
        seen = (np.diff(targets.offset) > 0).reshape(shape)
        light = run.estimate().reshape(REPLICATES, *shape)
        light = np.where(pair.T.reshape(*shape[:3], 1, 1) & seen, light, np.nan)
        found[:, index] = light.swapaxes(3, 4).reshape(REPLICATES, fibers, rows, columns)
    error = found.std(axis=0, ddof=1) / np.sqrt(REPLICATES)
    return PadLight(cells.spacing, BLOCKS, found.mean(axis=0), error)


def _cut(scene: Scene) -> Scene:
    """Return the scene whose sites are the middles of the cells."""
    pad = scene.pad
    side = max(CELL, pad.width / MAX_COLUMNS, pad.length / MAX_ROWS)
    columns, rows = (int(np.ceil(length / side - 1e-9)) for length in (pad.width, pad.length))
    middle = {"spacing": side, "centre_x": 0.0, "centre_y": 0.0}
    cells = unchecked(scene.sites, {"columns": columns, "rows": rows, **middle})
    return unchecked(scene, {"sites": cells})


def _wanted(cut: Scene, around: Array) -> NDArray[np.bool_]:
    """Return which cells of which fibers matter, ``(cell, fiber)``."""
    from scipy.ndimage import binary_dilation

    cells, fibers = cut.sites, cut.lamp_count
    holds = np.zeros((fibers, cells.rows, cells.columns), dtype=np.bool_)
    place = np.floor(around / cells.spacing + np.array([cells.columns, cells.rows]) / 2)
    fiber, point = np.nonzero(np.isfinite(place).all(axis=-1))
    column, row = place[fiber, point].astype(np.int64).T
    holds[fiber, np.clip(row, 0, cells.rows - 1), np.clip(column, 0, cells.columns - 1)] = True
    return np.asarray(binary_dilation(holds, np.ones((1, 3, 3)))).reshape(fibers, -1).T


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


class MaterialRender(NamedTuple):
    """One material ``(quantity,)``, and its light at each bend under the fibers in use."""

    material: Array
    light: PadLight


def reference_renders(
    setup: Setup,
    lit: Sequence[Sequence[int]],
    *,
    materials: int,
    samples: int,
    folder: Path,
    progress: OnProgress | None = None,
    render: Callable[..., PadLight] = render_pad_light,
) -> list[MaterialRender]:
    """Return renders of ``materials`` that fill the range (Sobol), kept or made now.

    The ``setup``'s own material does not matter; ``lit`` are the fibers that ``render`` renders at
    each bend, with ``samples`` light paths per fiber and cell, and ``folder`` keeps them.
    """
    key = setup.key(VERSION, [[int(fiber) for fiber in own] for own in lit], samples)
    paths = [folder / f"renders-{key}" / f"{number:03d}.npz" for number in range(materials)]
    renders = []
    for number, material in enumerate(setup.space.sobol(materials)):
        kept = read_or_drop(paths[number], *(field.name for field in fields(PadLight)))
        if kept is None:
            missing = sum(not path.exists() for path in paths[number + 1 :])
            light = render(
                setup.of(material), lit, samples=samples, seed=FIRST_SEED + number,
                around=setup.lines.on_pad,
                progress=_of_all(progress, number + 1, materials, missing) if progress else None,
            )  # fmt: skip
            kept = {name: np.asarray(value) for name, value in vars(light).items()}
            write_npz(paths[number], kept)
        light = PadLight(float(kept["cell"]), int(kept["blocks"]), kept["radiance"], kept["error"])
        renders.append(MaterialRender(material, light))
    return renders


def _of_all(progress: OnProgress, number: int, materials: int, missing: int) -> OnProgress:
    """Return what tells the progress of one render as that of all, ``missing`` ones included."""

    def said(at: Progress) -> None:
        remaining = at.eta_seconds or 0.0
        eta = remaining + missing * (at.seconds + remaining)
        done, total = at.done + (number - 1) * at.total, materials * at.total
        stage = f"material {number} of {materials}"
        progress(Progress(done, total, at.seconds, eta, stage))

    return said
