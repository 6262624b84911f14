"""The regression problem that every residual model solves, flattened to rows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from render.bending import Array
from render.scene import Scene
from surrogate.basis import SIZE
from surrogate.cells import Cells
from surrogate.graph import Checker
from surrogate.inputs import BRIGHTNESS
from surrogate.networks import NoResidual
from surrogate.preview_grid import PreviewGrid


@dataclass(frozen=True)
class Rows:
    """One row per (direction, fiber, bend, site), in this order; float32 tensors.

    Arguments:
        x: ``(row, input)`` inputs in the mirrored frame.
        basis: ``(row, output, normal)`` basis of the facet normal, from the row's own frame.
        target, weight: ``(row, normal)`` log(T_reference / T_preview) and its weight, 0 where the
            reference is not reliable.
        log_preview: ``(direction, fiber, bend, site, normal)`` float64.
    """

    x: Tensor
    basis: Tensor
    target: Tensor
    weight: Tensor
    log_preview: Array

    @property
    def shape(self) -> tuple[int, ...]:
        """``(direction, fiber, bend, site)``."""
        return self.log_preview.shape[:-1]

    @property
    def brightness(self) -> Array:
        """The standardised log preview ``(direction, fiber, bend, site)`` of the untouched pad."""
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
    checker = preview_checker(scene, grid)
    phi = torch.as_tensor(cells.phi, dtype=torch.float32)
    bend = torch.as_tensor(cells.bends, dtype=torch.float32).expand(len(phi), -1)
    with torch.no_grad():
        log_preview = checker.preview(phi, bend)
        x = checker.inputs(phi, bend, log_preview)
        unit = torch.eye(SIZE).reshape(SIZE, 1, 1, 1, 1, SIZE)
        unit = unit.expand(-1, *log_preview.shape[:-1], -1)
        basis = checker.expansion(unit, log_preview)
    normals = log_preview.shape[-1]
    known = torch.as_tensor(cells.reliable)
    target = torch.where(known, torch.as_tensor(cells.log_transport()) - log_preview, 0.0)
    return Rows(
        x=x.reshape(-1, x.shape[-1]),
        basis=basis.reshape(SIZE, -1, normals).transpose(0, 1).contiguous(),
        target=target.float().reshape(-1, normals),
        weight=torch.as_tensor(cells.weights(), dtype=torch.float32).reshape(-1, normals),
        log_preview=log_preview.double().numpy(),
    )


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
    return out
