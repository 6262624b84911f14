"""The preview over a free material: drawn for materials that fill the range, smooth in between.

Per cell the logarithm of the preview is a polynomial of the second degree in the material, fitted
by least squares to previews of some 16 materials; each has a slab response from random numbers of
its own, whose noise the fit averages. Leaving out each material in turn gives its error.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from render.arrays import Array
from render.scene.schema import Scene
from surrogate.model.materials import MaterialRange
from surrogate.model.preview_grid import PreviewGrid, draw_grid

MATERIALS = 16


@dataclass(frozen=True)
class LeftOut:
    """Relative error of the preview's polynomial at materials left out of its fit."""

    median: float
    p95: float
    worst: float


def draw_material_grid(
    scene: Scene,
    phi_count: int,
    bend_count: int,
    *,
    materials: int = MATERIALS,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[PreviewGrid, LeftOut | None]:
    """Return the grid of ``scene`` over what it leaves free, and its error; None without a range.

    Arguments:
        scene: the sensor.
        phi_count: nodes in phi.
        bend_count: nodes in the bend.
        materials: how many are drawn.
        progress: called with previews drawn and previews in all.
    """
    free = MaterialRange.of(scene)
    if free is None:
        return draw_grid(scene, phi_count, bend_count), None
    chosen, grids = free.samples(materials), []
    for number, material in enumerate(chosen):
        grids.append(draw_grid(free.scene_with(scene, material), phi_count, bend_count))
        if progress is not None:
            progress(number + 1, materials)
    drawn = np.stack([grid.log_transport for grid in grids])
    basis = np.concatenate([np.ones((materials, 1)), free.terms(chosen)], axis=1)
    inverse = np.linalg.pinv(basis)
    coefficients = np.tensordot(inverse, drawn, axes=1)
    # The residual of a material left out is the plain one over 1 - leverage.
    leverage = np.einsum("mt,tm->m", basis, inverse)
    missed = drawn - np.tensordot(basis, coefficients, axes=1)
    missed /= np.maximum(1.0 - leverage, 1e-9).reshape(-1, *[1] * (missed.ndim - 1))
    error = np.abs(np.expm1(missed))
    grid = PreviewGrid(
        coefficients[0],
        grids[0].phi,
        grids[0].bends,
        sum(grid.floored for grid in grids),
        slopes=coefficients[1:],
        free=free,
    )
    return grid, LeftOut(
        float(np.median(error)), float(np.quantile(error, 0.95)), float(error.max())
    )


def at_material(grid: PreviewGrid, material: Array) -> Array:
    """Return the log preview at the nodes of ``grid`` for one material ``(quantity,)``."""
    if grid.free is None or grid.slopes is None:
        return grid.log_transport
    slopes = np.tensordot(grid.free.terms(material), grid.slopes, axes=1)
    return np.asarray(grid.log_transport + slopes)
