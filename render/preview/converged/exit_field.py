"""The exit field: the light that leaves the inner faces of the layer for the first time.

Analog photons of every lamp enter the block as it is bent, walk in the layer with its corners, and
are projected onto the cells of the inner faces. One set of walks serves all directions of a lamp,
as in `render.preview.diffuser.emission`.
"""

from __future__ import annotations

import numpy as np

from render.arrays import Array
from render.geometry import FiberPoses, fiber_poses
from render.preview.diffuser.cache import fiber_ends
from render.preview.diffuser.emission import FiberEnd, radiance_of_nodes
from render.preview.diffuser.random_walk import deflect, tangent_frame
from render.scene import Scene
from render.preview.converged.block import (
    cell_count,
    directions_to_block,
    orthonormal_terms,
    to_block,
)
from render.preview.converged.walks import Block, FaceGrid, trace_lamp

REPEATS = 4
"""Photons that share a way to the block, and walk apart."""
PHOTON_KEY = 1 << 40
"""Family of the streams of photons; lamps are counted from it."""


def exit_field(
    scene: Scene, bend: float, lamp: int, phi: Array, block: Block, grid: FaceGrid, photons: int
) -> Array:
    """Return what a lamp of unit power sends out of the inner faces, ``(cell, term, node)``.

    Arguments:
        scene: the sensor.
        bend: rad.
        lamp: its number.
        phi: ``(node,)`` rad.
        block: of the scene at this bend.
        grid: the cells of its inner faces.
        photons: how many share the power.

    The terms are orthonormal (`orthonormal_terms`). Light that enters the block through the clear
    pad is not followed.
    """
    poses, end = fiber_poses(scene, bend), fiber_ends(scene)[lamp]
    if not poses.turns[lamp]:
        phi = np.array([np.pi / 2])
    origin, direction, weights = _launched(poses, end, lamp, phi, photons // REPEATS)
    out = np.zeros((cell_count(grid), 4 * (grid.degree + 1) ** 2, len(phi)))
    entered = np.zeros(2)
    trace_lamp(
        block, grid, to_block(scene, origin), directions_to_block(direction), weights,
        REPEATS, PHOTON_KEY + lamp, out, entered,
    )  # fmt: skip
    return np.asarray(orthonormal_terms(grid) @ out)


def _launched(
    poses: FiberPoses, end: FiberEnd, lamp: int, phi: Array, photons: int
) -> tuple[Array, Array, Array]:
    """Return origins and directions in the world ``(ray, 3)`` and weights ``(ray, node)``."""
    rng = np.random.Generator(np.random.Philox(key=PHOTON_KEY + lamp))
    axes = end.directions(phi)
    node = np.arange(photons) % len(phi)
    theta, flux = end.flux()
    angle = np.interp(rng.random(photons), flux, theta)
    s, t = tangent_frame(axes[node])
    direction = deflect(axes[node], np.cos(angle), rng).astype(np.float64)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    radius = 0.5 * end.diameter * np.sqrt(rng.random(photons))
    azimuth = 2 * np.pi * rng.random(photons)
    offset = radius[:, None] * (np.cos(azimuth)[:, None] * s + np.sin(azimuth)[:, None] * t)
    weights = radiance_of_nodes(end, axes, offset, direction)
    weights /= weights.mean(axis=1, keepdims=True) * photons
    frame = np.stack([poses.along[lamp], poses.inward[lamp], poses.up[lamp]])
    return poses.position[lamp] + offset @ frame, direction @ frame, weights
