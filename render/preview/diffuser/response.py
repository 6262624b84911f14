"""The slab response: the diffuser as a secondary light, from a random walk of light.

Each fiber makes a spot glow on the inner face of the diffuser. The response holds that glow as a
few point lights per fiber, each with a low-order directional distribution, as a function of phi.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from render.arrays import Array
from render.chebyshev import chebyshev_nodes, interpolation_weights
from render.errors import RenderError
from render.preview.diffuser.basis import (
    MIRROR_ALONG,
    directional_terms,
    linear_weights,
    moments,
    nonnegative,
)
from render.preview.diffuser.emission import FiberEnd, emit_diffuse, emit_from_fiber
from render.preview.diffuser.random_walk import Photons, Slab, walk

PHI_NODES, HEIGHTS = 11, 3
OFFSET_QUANTILES = (0.0, 0.36, 0.66, 0.88, 0.98)
"""Parts of the light within each offset along the edge."""
RAYS, BATCH, DIFFUSE_RAYS = 360_000, 60_000, 30_000
MIN_OFFSET_STEP = 1e-3
"""Least distance (mm) between offsets."""
OPAQUE_THICKNESS = 7.0
"""Optical thickness beyond which 1e-3 passes unscattered: that needs no lights of its own."""
MIN_TRANSMITTED = 1e-6
"""Part of a fiber's light that must pass the diffuser: with less, noise is all there is."""
MAX_EVENTS = 20_000_000
"""Scattering and reflection events after which no further batch is started."""


@dataclass(frozen=True)
class SlabResponse:
    """What one fiber of unit power makes of the diffuser's inner face.

    Arguments:
        phi: ``(node,)`` rad, Chebyshev points on [0, pi] or what was asked for.
        offsets: ``(offset,)`` mm along the edge from the fiber, ascending, symmetric.
        heights: ``(height,)`` mm above the camera-side face, Gauss points.
        radiance: ``(node, offset, height, term)`` in 1/sr: the area-integrated radiance of each
            point light is the sum over `directional_terms`; its intensity is that times the
            cosine to the face.
        albedo: part of diffuse light that comes back when it enters through the inner face.
    """

    phi: Array
    offsets: Array
    heights: Array
    radiance: Array
    albedo: float

    def at(self, phi: Array) -> Array:
        """Return ``radiance`` at ``phi`` ``(...)`` rad, ``(..., offset, height, term)``."""
        weights = interpolation_weights(self.phi, phi)
        return np.asarray(np.einsum("...j,jozt->...ozt", weights, self.radiance))

    def spread_upwards(self, heights: int) -> SlabResponse:
        """Return the same glow as ``heights`` points of light one above the other.

        The radiance per height is the polynomial through what the Gauss points stand for, so that
        light paths see a glow without gaps where they change suddenly with the height.
        """
        nodes, weights = np.polynomial.legendre.leggauss(len(self.heights))
        finer, finer_weights = np.polynomial.legendre.leggauss(heights)
        weights_up = interpolation_weights(nodes, finer) * finer_weights[:, None] / weights
        middle = 0.5 * (self.heights[0] + self.heights[-1])
        return replace(
            self,
            heights=middle * (finer + 1),
            radiance=nonnegative(np.einsum("hz,jozt->joht", weights_up, self.radiance)),
        )

    def power(self, phi: Array) -> Array:
        """Return the power ``(...)`` that leaves through the inner face."""
        return np.asarray(self.at(phi).sum(axis=(-3, -2)) @ moments()[0])


def compute_response(
    slab: Slab,
    fiber_end: FiberEnd,
    *,
    rays: int = RAYS,
    seed: int = 0,
    phi: Array | None = None,
    quantiles: Sequence[float] = OFFSET_QUANTILES,
    heights: int = HEIGHTS,
) -> SlabResponse:
    """Return the response from a random walk of ``rays`` photons over all phi nodes.

    ``rays`` photons start at ``phi`` ``(node,)`` rad, ascending and symmetric about pi/2, by
    default Chebyshev points on [0, pi]; fewer nodes give less noise for the same photons, at these
    nodes alone. ``quantiles`` are parts of the light within each offset along the edge, ascending
    from 0; ``heights`` counts points of light one above the other.
    """
    rng = np.random.default_rng(seed)
    phi = chebyshev_nodes(PHI_NODES, 0.0, np.pi) if phi is None else phi
    if np.abs(phi + phi[::-1] - np.pi).max() > 1e-9:
        raise RenderError(
            f"phi = {np.round(phi, 4).tolist()} rad, allowed: symmetric about pi/2", field="phi"
        )
    height = slab.height * 0.5 * (np.polynomial.legendre.leggauss(heights)[0] + 1)
    leaving: list[tuple[Photons, Array]] = []
    launched = events = 0
    batch = min(BATCH, rays)
    while launched < rays and events < MAX_EVENTS:
        photons, weight = emit_from_fiber(slab, fiber_end, phi, batch, rng)
        exiting, spent = walk(slab, photons, rng)
        leaving.append((exiting, exiting.weight[:, None] * weight[exiting.label]))
        launched, events = launched + batch, events + spent
    passed = max(float(power.sum(axis=0).max()) for _, power in leaving)
    if passed < MIN_TRANSMITTED:
        raise RenderError(
            f"the diffuser lets only {passed:.1e} of the light through, allowed: at least "
            f"{MIN_TRANSMITTED:g}; make it thinner, less absorbing, or bring the fibers nearer",
            field="diffuser",
        )
    offsets = _offsets(leaving, quantiles)
    if slab.optical_depth(slab.thickness + min(fiber_end.gap, 0.0)) < OPAQUE_THICKNESS:
        leaving = [
            (exiting[~exiting.straight], power[~exiting.straight]) for exiting, power in leaving
        ]
    deposits = [_projected(exiting, power, offsets, height) for exiting, power in leaving]
    back = _returned(slab, min(DIFFUSE_RAYS, rays), rng)
    return SlabResponse(
        phi,
        offsets,
        height,
        nonnegative(_symmetric(np.mean(deposits, axis=0))),
        back,
    )


@lru_cache(maxsize=16)
def diffuse_albedo(slab: Slab) -> float:
    """Return the part of diffuse light that comes back when it enters through the inner face."""
    return _returned(slab, DIFFUSE_RAYS, np.random.default_rng(0))


def _returned(slab: Slab, rays: int, rng: np.random.Generator) -> float:
    back, _ = walk(slab, emit_diffuse(slab, rays, rng), rng)
    return float(back.weight.sum())


def _offsets(leaving: list[tuple[Photons, Array]], quantiles: Sequence[float]) -> Array:
    """Return points along the edge that share the light of all nodes by ``quantiles``."""
    distance = np.concatenate([np.abs(exiting.position[:, 0]) for exiting, _ in leaving])
    power = np.concatenate([power.sum(axis=1) for _, power in leaving])
    order = np.argsort(distance)
    half = np.interp(quantiles, np.cumsum(power[order]) / power.sum(), distance[order])
    # Points must stay apart even when a clear layer keeps all light in one spot.
    half = np.maximum.accumulate(half + MIN_OFFSET_STEP * np.arange(len(half))) - half[0]
    return np.concatenate([-half[:0:-1], half])


def _projected(exiting: Photons, power: Array, offsets: Array, heights: Array) -> Array:
    """Project photons onto the basis: ``(node, offset, height, term)``.

    Along the edge linear weights, upwards Lagrange weights (exact for quadratic light paths), over
    directions the least-squares radiance, whose normal equations are the moments of the terms.
    """
    position = exiting.position.astype(np.float64)
    along = linear_weights(position[:, 0], offsets)
    up = interpolation_weights(heights, position[:, 2])
    terms = directional_terms(exiting.direction.astype(np.float64))
    basis = up[:, :, None] * np.linalg.solve(moments(), terms.T).T[:, None]
    return np.stack(
        [
            np.einsum("pj,pzt->jzt", power * weight[:, None], basis, optimize=True)
            for weight in along.T
        ],
        axis=1,
    )


def _symmetric(radiance: Array) -> Array:
    """Average with the mirror image: phi and pi - phi, along and against the edge."""
    return np.asarray(0.5 * (radiance + MIRROR_ALONG * radiance[::-1, ::-1]))
