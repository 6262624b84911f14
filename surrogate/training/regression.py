"""The regression problem that every residual model solves, flattened to rows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from render.arrays import Array
from render.scene.schema import Scene
from surrogate.model.checker_module import Checker
from surrogate.model.facet_basis import SIZE
from surrogate.model.features import BRIGHTNESS
from surrogate.model.networks import NoResidual
from surrogate.model.preview_grid import PreviewGrid
from surrogate.training.dataset import Cells

NOISE_FLOOR = 0.02
"""Relative error that no render is trusted beyond (finite chains, facets of finite size)."""


@dataclass(frozen=True)
class Rows:
    """One row per (direction, fiber, bend, site), in this order; float32 tensors.

    Arguments:
        x: ``(row, input)`` inputs in the mirrored frame.
        basis: ``(row, output, normal)`` basis of the facet normal, from the row's own frame.
        ratio: ``(row, normal)`` T_reference / T_preview; noisy, may be 0 or negative.
        noise: ``(row, normal)`` its relative standard error, smoothed (:func:`smooth_noise`).
        log_preview: ``(direction, fiber, bend, site, normal)`` float64.
    """

    x: Tensor
    basis: Tensor
    ratio: Tensor
    noise: Tensor
    log_preview: Array

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

        Arguments:
            coefficients: ``(member, row, output)``.
        """
        out = expand(coefficients, self.basis).double().numpy()
        return np.asarray(out.reshape(len(coefficients), *self.log_preview.shape))


def expand(coefficients: Tensor, basis: Tensor) -> Tensor:
    """Return ``(..., row, normal)`` from ``(..., row, output)`` and ``(row, output, normal)``."""
    return torch.einsum("...rh,rhn->...rn", coefficients, basis)


def preview_checker(scene: Scene, grid: PreviewGrid) -> Checker:
    """Return the checker without residual: the preview alone, with exposure and lambda 1."""
    nothing = NoResidual(SIZE)
    return Checker(scene, grid, nothing, exposure=1.0, lam=1.0, spread=(-20.0, 0.0))


def build_rows(scene: Scene, grid: PreviewGrid, cells: Cells) -> Rows:
    """Return the regression rows of ``cells`` on top of the preview ``grid``."""
    rows, basis, log_preview = cell_features(
        preview_checker(scene, grid), cells.phi, cells.bends, cells.material
    )
    normals = len(log_preview)
    log_cells = log_preview.movedim(0, -1).double().numpy()
    preview = np.exp(log_cells)
    noise = smooth_noise(cells.transport, cells.error, rows.double().numpy())
    return Rows(
        x=rows,
        basis=basis,
        ratio=torch.as_tensor(cells.transport / preview, dtype=torch.float32).reshape(-1, normals),
        noise=torch.as_tensor(noise, dtype=torch.float32).reshape(-1, normals),
        log_preview=log_cells,
    )


def cell_features(
    checker: Checker, phi: Array, bends: Array, material: Array | None = None
) -> tuple[Tensor, Tensor, Tensor]:
    """Return inputs ``(row, input)``, basis ``(row, output, normal)`` and the log preview.

    Rows run over ``(direction, fiber, bend, site)`` for ``phi`` ``(direction, fiber)`` and
    ``bends`` ``(bend,)`` rad; the log preview is ``(normal, direction, fiber, bend, site)``.
    ``material`` is that of each direction, ``(direction, quantity)``, where the scene leaves it
    free (default: the scene's own).
    """
    at = torch.as_tensor(phi, dtype=torch.float32)
    bend = torch.as_tensor(bends, dtype=torch.float32).expand(len(at), -1)
    made_of = None
    if checker.free is not None:
        own = np.tile(checker.free.nominal, (len(phi), 1)) if material is None else material
        made_of = torch.as_tensor(checker.free.unit(own), dtype=torch.float32)
    with torch.no_grad():
        log_preview = checker.preview(at, bend, made_of)
        x = checker.inputs(at, bend, log_preview, made_of)
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

    Arguments:
        transport: ``(..., normal)`` reference.
        error: ``(..., normal)`` its standard error.
        x: ``(row, input)``.
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


def deviance(ratio: Tensor, residual: Tensor) -> Tensor:
    """Return the gamma deviance ``y exp(-r) + r`` of every cell, up to a constant.

    ``y`` is T_reference / T_preview and ``r`` the residual. Its minimum over noisy ``y`` is
    log E[y], whatever the noise (McCullagh and Nelder 1989, 8.3), where least squares in log y
    would be biased by -variance / 2 and could not use cells that came out as 0.
    """
    return ratio * torch.exp(-residual) + residual


def held_out(residuals: Array, fold: np.ndarray) -> Array:
    """Return, for every cell, the residual of the member that was trained without it.

    Arguments:
        residuals: ``(member, direction, fiber, bend, site, normal)``; member ``m`` was trained
            without fold ``m``.
        fold: ``(direction, fiber, bend)``; -1 where no member was held out (the mean is taken).
    """
    out = residuals.mean(axis=0)
    for member, residual in enumerate(residuals):
        out[fold == member] = residual[fold == member]
    return np.asarray(out)
