"""The exit field: the light that leaves the inner faces of the layer for the first time.

Analog photons of every lamp enter the block as it is bent, walk in the layer with its corners, and
are projected onto the cells of the inner faces. One set of walks serves all directions of a lamp,
as in `render.preview.diffuser.emission`.
"""

from __future__ import annotations

import numpy as np

from render.arrays import Array
from render.preview.converged.block import (
    cell_count,
    directions_to_block,
    orthonormal_terms,
    term_count,
    to_block,
)
from render.preview.converged.color_noise import Halved
from render.preview.converged.launching import launched
from render.preview.converged.walks import Block, FaceGrid, trace_lamp
from render.scene import Scene

REPEATS = 4
"""Photons that share a way to the block, and walk apart."""
PHOTON_KEY = 1 << 40
"""Family of the streams of photons; lamps are counted from it."""


def exit_field(
    scene: Scene,
    bend: float,
    lamp: int,
    phi: Array,
    block: Block,
    grid: FaceGrid,
    photons: int,
    seed: int = 0,
) -> Halved[Array]:
    """Return what a lamp of unit power sends out of the inner faces, ``(cell, term, node)``.

    Arguments:
        scene: the sensor.
        bend: rad.
        lamp: its number.
        phi: ``(node,)`` rad.
        block: of the scene at this bend.
        grid: the cells of its inner faces.
        photons: how many share the power.
        seed: of their random numbers.

    The terms are orthonormal (`orthonormal_terms`). Light that enters the block through the clear
    pad is not followed.
    """
    key = PHOTON_KEY + (seed << 20) + lamp
    origin, direction, weights = launched(scene, bend, lamp, phi, range(photons // REPEATS), key)
    out = np.zeros((cell_count(grid), term_count(grid), weights.shape[1]))
    origin, direction = to_block(scene, origin), directions_to_block(direction)
    half = len(origin) // 2
    trace_lamp(block, grid, origin[:half], direction[:half], weights[:half], REPEATS, key, 0, out)
    first = out.copy()
    trace_lamp(
        block, grid, origin[half:], direction[half:], weights[half:], REPEATS, key,
        REPEATS * half, out,
    )  # fmt: skip
    terms = orthonormal_terms(grid)
    return Halved(np.asarray(terms @ out), np.asarray(terms @ (2.0 * first - out)))
