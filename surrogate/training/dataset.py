"""The data set: reference tables as training cells, and the regression data made of them.

Training cells say what the residual must be, how well it is known, and which cells belong together.

Axes of every array here: ``(direction, fiber, bend, site, normal)``; fibers are the copies of
`surrogate.model.lamp_copies` where the skin's albedo depends on the channel. The rows of one
direction index form one lighting pattern with its own phi per fiber, so that the arrays line up
with a batch of the checker; the normals are the facets, then the untouched pad.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from render.arrays import Array
from render.errors import TableError
from render.geometry import counted_sites
from render.reference import converged
from render.scene import Scene
from render.transport import TransportTable
from surrogate.model.checker_module import CheckerModule
from surrogate.model.facet_basis import SIZE, mirror_signs
from surrogate.model.features import BRIGHTNESS
from surrogate.model.lamp_copies import copied_poses, split_channels
from surrogate.model.networks import NoResidual
from surrogate.model.preview_grid import PreviewGrid

NOISE_FLOOR = 0.02
"""Relative error that no render is trusted beyond (finite chains, facets of finite size)."""
MAX_RESIDUAL = 25.0
"""Largest |log T_reference / T_preview| of a prediction, eleven decades: what is wilder, as a ridge
of a small penalty is on cells that it has not seen, is as wrong, and has an exponential."""


@dataclass(frozen=True)
class TrainingCells:
    """Reference transport as training data.

    Arguments:
        phi: ``(direction, fiber)`` rad; bends: ``(bend,)`` rad.
        transport, error: reference and its standard error, ``(direction, fiber, bend, site,
            normal)``.
        group: ``(direction, fiber, bend)`` integers; mirror twins share a group.
        fiber_group, direction_group, bend_group: the same shape, coarser groups.
        block: ``(direction,)`` which material the cells of a direction are of.
        material: ``(direction, quantity)`` that material, where the scene leaves it free.
        half_difference: the shape of ``transport``, see `TransportTable`; None where unknown.
    """

    phi: Array
    bends: Array
    transport: Array
    error: Array
    group: np.ndarray
    fiber_group: np.ndarray
    direction_group: np.ndarray
    bend_group: np.ndarray
    block: np.ndarray
    material: Array | None = None
    half_difference: Array | None = None

    @property
    def material_group(self) -> np.ndarray:
        """The block in the shape of the other groups."""
        return np.broadcast_to(self.block[:, None, None], self.group.shape)

    @property
    def reliable(self) -> np.ndarray:
        """True where the render of the cell has converged; others are still fitted to."""
        return converged(self.transport, self.error)


def training_cells(
    scene: Scene, tables: Sequence[TransportTable], materials: Array | None = None
) -> TrainingCells:
    """Return the training cells of reference tables with background, one per material.

    ``materials`` is ``(material, quantity)``, where the scene leaves it free. The same cell of two
    materials is in one group: held out, it is unseen in all of them.

    Raises:
        TableError: a table lacks bends or background or does not fit the scene, or tables have
            different bends.
    """
    parts, bends = [_cells_of(scene, table) for table in tables], tables[0].bends
    if any(not np.array_equal(table.bends, bends) for table in tables):
        raise TableError(
            "the reference tables of the materials have different bends: render them together",
            field="bends",
        )
    transport, error = (np.concatenate(values) for values in zip(*parts, strict=True))
    block = np.repeat(np.arange(len(tables)), [len(table.phi) for table in tables])
    phi = np.concatenate([table.phi for table in tables])
    phi = np.repeat(phi[:, None], transport.shape[1], axis=1)
    keys = _group_keys(scene, phi, bends)
    return TrainingCells(
        phi=phi,
        bends=bends,
        transport=transport,
        error=error,
        group=_numbered(keys),
        fiber_group=_numbered(keys[..., :2]),
        direction_group=_numbered(keys[..., 2:3]),
        bend_group=_numbered(keys[..., 3:]),
        block=block,
        material=None if materials is None else materials[block],
        half_difference=_half_difference(scene, tables),
    )


def _half_difference(scene: Scene, tables: Sequence[TransportTable]) -> Array | None:
    """Return that of all tables, ``(direction, fiber, bend, site, normal)``, if all have it."""
    known = [
        split_channels(scene, table.half_difference).swapaxes(0, 1)
        for table in tables
        if table.half_difference is not None
    ]
    return np.concatenate(known) if len(known) == len(tables) else None


def _cells_of(scene: Scene, table: TransportTable) -> tuple[Array, Array]:
    """Return transport and error ``(direction, fiber, bend, site, normal)`` of a table."""
    channels = (len(scene.palette.channels),) if scene.by_channel else ()
    expected = (scene.lamp_count, len(counted_sites(scene)), scene.indenter.faces, *channels)
    shape = (table.T.shape[0], *table.T.shape[3:])
    if shape != expected:
        named = "fiber, site, facet" + ", channel" * bool(channels)
        raise TableError(
            f"the reference table has ({named}) = {shape}, allowed: {expected} as in "
            f"the scene {scene.name}: render it for this scene",
            field="T",
        )
    if table.background is None or table.background_se is None:
        raise TableError(
            "the reference table has no background: render it together with the facets",
            field="background",
        )
    if table.bends.shape != (table.T.shape[2],):
        raise TableError(
            f"the reference table names {table.bends.size} bends for {table.T.shape[2]}: "
            "store its bends",
            field="bends",
        )
    facets, pads = (table.T, table.se), (table.background, table.background_se)
    transport, error = (
        np.concatenate(
            [split_channels(scene, facet), split_channels(scene, pad)[..., None]], axis=-1
        ).swapaxes(0, 1)
        for facet, pad in zip(facets, pads, strict=True)
    )
    return transport, error


def _group_keys(scene: Scene, phi: Array, bends: Array) -> Array:
    """Return |x|, y, mirrored phi and bend of every group, ``(direction, fiber, bend, 4)``."""
    poses = copied_poses(scene)
    turns = (mirror_signs(scene) < 0) & (np.abs(poses.along[:, 0]) > 0.5)
    folded = np.where(turns, np.pi - phi, phi)
    shape = (*phi.shape, len(bends))
    columns = [
        np.broadcast_to(np.abs(poses.position[:, 0])[None, :, None], shape),
        np.broadcast_to(poses.position[:, 1][None, :, None], shape),
        np.broadcast_to(folded[..., None], shape),
        np.broadcast_to(bends, shape),
    ]
    return np.round(np.stack(columns, axis=-1), 6)


def _numbered(keys: Array) -> np.ndarray:
    """Return one integer per distinct row of ``keys`` ``(..., column)``."""
    _, index = np.unique(keys.reshape(-1, keys.shape[-1]), axis=0, return_inverse=True)
    return np.asarray(index).reshape(keys.shape[:-1])


def folds(group: np.ndarray, count: int, seed: int) -> np.ndarray:
    """Return the fold (0 .. count-1) of every entry; whole groups go to one fold, evenly."""
    groups = int(group.max()) + 1
    dealt = np.arange(groups) % count
    return np.asarray(np.random.default_rng(seed).permutation(dealt)[group])


def interior_folds(group: np.ndarray, count: int, seed: int, inner: bool) -> np.ndarray:
    """Return folds of whole groups; with ``inner`` the first and the last group stay in: fold -1.

    Groups are numbered in the order of their value, so that what ``inner`` holds out is always
    interpolation inside the trained range.
    """
    groups = int(group.max()) + 1
    chosen = np.arange(1, groups - 1) if inner else np.arange(groups)
    out = np.full(groups, -1)
    dealt = np.arange(len(chosen)) % max(1, min(count, len(chosen)))
    out[chosen] = np.random.default_rng(seed).permutation(dealt)
    return np.asarray(out[group])


@dataclass(frozen=True)
class RegressionData:
    """One row per (direction, fiber, bend, site), in this order; float32 tensors.

    Arguments:
        x: ``(row, input)`` inputs in the mirrored frame.
        basis: ``(row, output, normal)`` basis of the facet normal, from the row's own frame.
        ratio: ``(row, normal)`` T_reference / T_preview; noisy, may be 0 or negative.
        noise: ``(row, normal)`` its relative standard error, smoothed (:func:`smooth_noise`).
        log_preview: ``(direction, fiber, bend, site, normal)`` float64.
        half_difference: ``(row, normal)`` that of the ratio, see `TransportTable`; or None.
    """

    x: Tensor
    basis: Tensor
    ratio: Tensor
    noise: Tensor
    log_preview: Array
    half_difference: Tensor | None = None

    @property
    def shape(self) -> tuple[int, ...]:
        """``(direction, fiber, bend, site)``."""
        return self.log_preview.shape[:-1]

    @property
    def weight(self) -> Tensor:
        """Weight of every cell ``(row, normal)``: inverse variance, 1 well below NOISE_FLOOR."""
        return NOISE_FLOOR**2 / (self.noise**2 + NOISE_FLOOR**2)

    @property
    def brightness(self) -> Array:
        """The standardized log preview ``(direction, fiber, bend, site)`` of the untouched pad."""
        return self.x[:, BRIGHTNESS].double().numpy().reshape(self.shape)

    def fold_rows(self, fold: np.ndarray) -> Tensor:
        """Return the fold of every row, from ``(direction, fiber, bend)`` integers."""
        return torch.as_tensor(np.repeat(fold.ravel(), self.shape[3]))

    def residuals(self, coefficients: Tensor) -> Array:
        """Return log T_prediction - log T_preview, ``(member, direction, ..., normal)`` float64.

        ``coefficients`` are ``(member, row, output)``.
        """
        out = expand(coefficients, self.basis).double().numpy().clip(-MAX_RESIDUAL, MAX_RESIDUAL)
        return np.asarray(out.reshape(len(coefficients), *self.log_preview.shape))


def expand(coefficients: Tensor, basis: Tensor) -> Tensor:
    """Return ``(..., row, normal)`` from ``(..., row, output)`` and ``(row, output, normal)``."""
    return torch.einsum("...rh,rhn->...rn", coefficients, basis)


def preview_checker(scene: Scene, grid: PreviewGrid) -> CheckerModule:
    """Return the checker without residual: the preview alone, with exposure and lambda 1."""
    nothing = NoResidual(SIZE)
    return CheckerModule(scene, grid, nothing, exposure=1.0, lam=1.0, spread=(-20.0, 0.0))


def build_rows(scene: Scene, grid: PreviewGrid, cells: TrainingCells) -> RegressionData:
    """Return the regression rows of ``cells`` on top of the preview ``grid``."""
    rows, basis, log_preview = cell_features(
        preview_checker(scene, grid), cells.phi, cells.bends, cells.material
    )
    normals = len(log_preview)
    log_cells = log_preview.movedim(0, -1).double().numpy()
    preview = np.exp(log_cells)
    noise = smooth_noise(cells.transport, cells.error, rows.double().numpy())

    def relative(values: Array) -> Tensor:
        return torch.as_tensor(values / preview, dtype=torch.float32).reshape(-1, normals)

    half = cells.half_difference
    return RegressionData(
        x=rows,
        basis=basis,
        ratio=relative(cells.transport),
        noise=torch.as_tensor(noise, dtype=torch.float32).reshape(-1, normals),
        log_preview=log_cells,
        half_difference=None if half is None else relative(half),
    )


def cell_features(
    checker: CheckerModule, phi: Array, bends: Array, material: Array | None = None
) -> tuple[Tensor, Tensor, Tensor]:
    """Return inputs ``(row, input)``, basis ``(row, output, normal)`` and the log preview.

    Rows run over ``(direction, fiber, bend, site)`` for ``phi`` ``(direction, fiber)`` and
    ``bends`` ``(bend,)`` rad; the log preview is ``(normal, direction, fiber, bend, site)``.
    ``material`` is that of each direction, ``(direction, quantity)``, where the scene leaves it
    free (default: the scene's own).
    """
    directions = torch.as_tensor(phi, dtype=torch.float32)
    bend = torch.as_tensor(bends, dtype=torch.float32).expand(len(directions), -1)
    unit_material = None
    if checker.free is not None:
        materials = np.tile(checker.free.nominal, (len(phi), 1)) if material is None else material
        unit_material = torch.as_tensor(checker.free.unit(materials), dtype=torch.float32)
    with torch.no_grad():
        log_preview = checker.preview(directions, bend, unit_material)
        x = checker.inputs(directions, bend, log_preview, unit_material)
        # One member for every basis function, with 1 for its coefficient.
        unit = torch.eye(SIZE).reshape(SIZE, SIZE, 1, 1, 1, 1)
        basis = checker.expansion(unit.expand(-1, -1, *log_preview.shape[1:]), log_preview)
    rows = x.reshape(len(x), -1).t().contiguous()
    functions = basis.reshape(SIZE, len(log_preview), -1).permute(2, 0, 1).contiguous()
    return rows, functions, log_preview


def smooth_noise(transport: Array, error: Array, x: Array) -> Array:
    """Return the relative standard error of every cell, ``(row, normal)``, from a smooth model.

    The error bar of a single cell comes from few replicates and falls and rises with the cell
    itself; weights made of it would prefer cells that came out dark. So the logarithm of the
    relative error is fitted by a linear model of the row's inputs, per normal, and the model is
    used. Cells without a positive value or error bar have no part in it.

    ``transport`` and its standard ``error`` are ``(..., normal)``, ``x`` is ``(row, input)``.
    """
    values, bars = (a.reshape(len(x), -1) for a in (transport, error))
    design = np.concatenate([np.ones((len(x), 1)), x], axis=1)
    out = np.zeros(values.shape)
    for normal in range(values.shape[1]):
        known = (values[:, normal] > 0) & (bars[:, normal] > 0)
        if not known.any():
            continue  # an exact reference, as in tests and demonstrations
        target = np.log(bars[known, normal] / values[known, normal])
        model, *_ = np.linalg.lstsq(design[known], target)
        out[:, normal] = np.exp(np.clip(design @ model, -10.0, 3.0))
    return out
