"""The preview as the surrogate holds it: logarithms on Chebyshev nodes in phi and in bend.

Between the nodes the logarithm is interpolated by the polynomial through all of them, in phi and
in bend. The logarithm keeps ten decades of brightness equally accurate and the result positive.

Over a free material the logarithm of a cell is a polynomial of the second degree, fitted by least
squares to previews of some 16 materials that fill the range; each has a slab response from random
numbers of its own, whose noise the fit averages. Leaving out each material in turn gives its error.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from render.arrays import Array
from render.chebyshev import chebyshev_nodes, interpolation_weights
from render.errors import TableError
from render.progress import Clock, OnProgress
from render.scene import Scene
from surrogate.model.lamp_copies import split_channels
from surrogate.model.materials import MaterialRange

FLOOR = 1e-9
"""Darkest preview that is told from black, relative to the brightest cell of the grid."""
MATERIALS = 16
"""How many materials the preview is drawn for, where the scene leaves its material free."""


@dataclass(frozen=True)
class PreviewGrid:
    """Logarithm of the preview's transport on a grid of directions and bends.

    Arguments:
        log_transport: ``(fiber, phi_node, bend_node, site, normal)`` float64; the normals are the
            facets, then the untouched pad; logarithm of 1/(mm^2 sr). Where the skin's albedo
            depends on the channel, fibers are the copies of `surrogate.model.lamp_copies`.
        phi, bends: Chebyshev nodes, rad, ascending.
        floored: number of cells that were darker than ``FLOOR`` and hold it instead.
        slopes: how the logarithm follows a free material, ``(term, fiber, ...)``, times the terms
            of ``free``.
        free: the range of the free material.
        photon_noise: of facet colors, relative, where converged light corrected them: the largest
            of its bends (`render.preview.converged.color_noise`), before the correction; None
            where the shader's light is as drawn.
    """

    log_transport: Array
    phi: Array
    bends: Array
    floored: int
    slopes: Array | None = None
    free: MaterialRange | None = None
    photon_noise: float | None = None

    def evaluate(self, phi: Array, bends: Array) -> Array:
        """Return the logarithm ``(fiber, phi, bend, site, normal)`` at ``phi`` and ``bends``."""
        in_phi = interpolation_weights(self.phi, phi)
        in_bend = interpolation_weights(self.bends, bends)
        out = np.einsum("pj,qb,fjbsn->fpqsn", in_phi, in_bend, self.log_transport, optimize=True)
        return np.asarray(out)


def draw_grid(
    scene: Scene, phi_count: int, bend_count: int, progress: OnProgress | None = None
) -> PreviewGrid:
    """Draw the preview of ``scene`` on ``phi_count`` by ``bend_count`` Chebyshev nodes.

    phi covers [0, pi], the bend [0, largest angle of the scene]; a scene with one bend, or without
    a lamp that turns, gets one node there. ``progress`` is told of every bend.

    Raises:
        GraphicsError: when no OpenGL library can draw.
        TableError: when the preview is black or not finite.
    """
    from render.preview import Preview
    from render.preview.facet_blur import facet_blurs

    phi, bends = grid_nodes(scene, phi_count, bend_count)
    drawn, clock = [], Clock(len(bends), progress)
    with Preview(scene) as preview, ThreadPoolExecutor(os.cpu_count()) as pool:
        # What the camera mixes takes most of the time on pads that bend: all cores make it ahead.
        ahead = [] if scene.states or len(bends) == 1 else list(bends)
        mixed = [pool.submit(facet_blurs, scene, float(bend), 1) for bend in ahead]
        for number, bend in enumerate(bends):
            if mixed:
                mixed[number].result()
            drawn.append(preview.transport(phi, bend[None]))
            clock.tick()
    transport, background = (np.concatenate(parts, axis=2) for parts in zip(*drawn, strict=True))
    facets, pad = split_channels(scene, transport), split_channels(scene, background)
    return grid_from_transport(facets, pad, phi, bends)


def grid_nodes(scene: Scene, phi_count: int, bend_count: int) -> tuple[Array, Array]:
    """Return the nodes in phi and bend (rad) that :func:`draw_grid` draws at.

    Named states are what a model knows, and there is nothing between them: the nodes are theirs.
    """
    if scene.states is not None:
        return direction_nodes(scene, phi_count), np.array(scene.state_axis)
    low, high = bend_range(scene)
    bends = np.array([high]) if low == high else chebyshev_nodes(bend_count, low, high)
    return direction_nodes(scene, phi_count), bends


def direction_nodes(scene: Scene, count: int) -> Array:
    """Return ``count`` Chebyshev nodes in phi (rad), or one where no lamp of ``scene`` turns."""
    return chebyshev_nodes(count if any(scene.turning) else 1, 0.0, np.pi)


def is_one_node(scene: Scene) -> bool:
    """Return whether all of ``scene`` is known at its nodes: one direction, bend and material.

    A bend, or any number of named states.
    """
    return not any(scene.turning) and len(set(scene.bending.angles)) == 1 and scene.free is None


def bend_range(scene: Scene) -> tuple[float, float]:
    """Return the bends (rad) that a model of ``scene`` is trained for, from flat if it bends."""
    angles = scene.bending.angles
    return (min(angles), max(angles)) if len(set(angles)) == 1 else (0.0, max(angles))


def grid_from_transport(
    transport: Array, background: Array, phi: Array, bends: Array
) -> PreviewGrid:
    """Return the grid of a preview drawn at the nodes ``phi`` and ``bends``.

    Arguments:
        transport: ``(fiber, phi_node, bend_node, site, facet)``.
        background: ``(fiber, phi_node, bend_node, site)``.
        phi: ``(phi_node,)`` rad.
        bends: ``(bend_node,)`` rad.
    """
    cells = np.concatenate([transport, background[..., None]], axis=-1)
    brightest = float(cells.max())
    if not np.isfinite(cells).all():
        lamp = int(np.argwhere(~np.isfinite(cells))[0, 0])
        raise TableError(
            f"the preview of lamp {lamp} is not finite somewhere, allowed: finite numbers; look at "
            "it with `tactilux render`",
            field="preview",
        )
    if brightest <= 0:
        raise TableError(
            "the preview is black: no light of any lamp that the skin reflects gets to the camera "
            "from a site, allowed: some; coating.albedo has to be above 0 and the lamps aimed at "
            "the skin (tactilux describe says which hardly light the pad)",
            field="preview",
        )
    dark = cells < FLOOR * brightest
    log_transport = np.log(np.where(dark, FLOOR * brightest, cells))
    return PreviewGrid(log_transport, phi, bends, int(dark.sum()))


@dataclass(frozen=True)
class InterpolationError:
    """Relative error of the grid against the preview itself, away from what it was drawn at."""

    median: float
    p95: float
    worst: float

    @classmethod
    def of(cls, error: Array) -> InterpolationError:
        """Return the summary of relative errors."""
        return cls(float(np.median(error)), float(np.quantile(error, 0.95)), float(error.max()))


def interpolation_error(scene: Scene, grid: PreviewGrid) -> InterpolationError:
    """Draw the preview halfway (in Chebyshev angle) between the nodes and compare."""
    from render.preview import Preview

    phi = _between(grid.phi)
    bends = _between(grid.bends) if scene.states is None else grid.bends
    with Preview(scene) as preview:
        drawn = preview.transport(phi, bends)
    transport, background = (split_channels(scene, part) for part in drawn)
    exact = np.concatenate([transport, background[..., None]], axis=-1)
    floor = np.exp(grid.log_transport.min())
    error = np.abs(np.exp(grid.evaluate(phi, bends)) / np.maximum(exact, floor) - 1.0)
    return InterpolationError.of(error)


def draw_material_grid(
    scene: Scene,
    phi_count: int,
    bend_count: int,
    *,
    materials: int = MATERIALS,
    progress: OnProgress | None = None,
) -> tuple[PreviewGrid, InterpolationError | None]:
    """Return the grid of ``scene`` over what it leaves free, and its error; None without a range.

    ``progress`` is told of every preview that is drawn.
    """
    free = MaterialRange.of(scene)
    if free is None:
        return draw_grid(scene, phi_count, bend_count), None
    chosen, grids = free.samples(materials), []
    clock = Clock(materials, progress)
    for material in chosen:
        grids.append(draw_grid(free.scene_with(scene, material), phi_count, bend_count))
        clock.tick()
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
    return grid, InterpolationError.of(error)


def _between(nodes: Array) -> Array:
    if len(nodes) == 1:
        return nodes
    x = -np.cos(np.pi * (np.arange(len(nodes) - 1) + 0.5) / (len(nodes) - 1))
    return np.asarray(nodes[0] + 0.5 * (nodes[-1] - nodes[0]) * (x + 1.0))
