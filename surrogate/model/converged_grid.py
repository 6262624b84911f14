"""The grid of the converged preview: the shader's, times what it misses of the light."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from render.arrays import Array
from render.chebyshev import interpolation_weights
from render.preview.converged import NODES, ConvergedTransport
from render.scene import Scene
from surrogate.model.lamp_copies import copied, split_channels
from surrogate.model.preview_grid import FLOOR, PreviewGrid

BEND_DEGREE = 3
"""In the bend, of the polynomial that corrects the shader's logarithm."""
SHADER_ERROR = 0.4
"""One standard deviation of a cell of the shader's, relative, once its lamp's light is right."""
LAMP_ERROR = 0.6
"""The same of the light of a lamp in one direction at one bend."""


def corrected(
    grid: PreviewGrid, scene: Scene, found: ConvergedTransport, nodes: Array = NODES
) -> PreviewGrid:
    """Return the shader's grid times the ratio of converged transport to it.

    At ``nodes`` and the scene's own bends, the ratio of a lamp's light is the mean of what was
    found and of 1, weighed by their variances: that of the noise, and `LAMP_ERROR` squared. The
    ratio of a cell is in the same way that of its lamp and what was found, with `SHADER_ERROR`. Its
    logarithm is interpolated in direction by the polynomial through ``nodes``, in bend by one of
    degree `BEND_DEGREE` at most, constant beyond the scene's own. Of a lamp that turns one node
    says how bright it is, not where.
    """
    own = np.array(scene.bending.angles)
    drawn = np.exp(grid.evaluate(nodes, own))
    grain = split_channels(scene, found.grain)[..., None, None]
    light = split_channels(scene, found.cells)
    # Facets of a site share photons: a lamp's light is known as well as that of its sites.
    normals = drawn.shape[-1]
    whole = drawn.sum(axis=(3, 4), keepdims=True)
    lamps = light.sum(axis=(3, 4), keepdims=True) / whole
    share = 1.0 + _trust(normals * grain / whole, LAMP_ERROR) * (lamps - 1.0)
    cells = share + _trust(grain / drawn, SHADER_ERROR) * (light / drawn - share)
    if len(nodes) == 1:
        turning = copied(scene, np.array(scene.turning))
        cells[turning] = np.broadcast_to(share, cells.shape)[turning]
    ratio = np.log(np.maximum(cells, FLOOR))
    in_phi = interpolation_weights(nodes, grid.phi)
    degree = min(len(set(own)) - 1, BEND_DEGREE)
    at_own, at_nodes = (
        np.polynomial.chebyshev.chebvander(at / max(own.max(), 1.0), degree)
        for at in (own, np.clip(grid.bends, own.min(), own.max()))
    )
    in_bend = at_nodes @ np.linalg.pinv(at_own)
    change = np.einsum("pj,qb,fjbsn->fpqsn", in_phi, in_bend, ratio, optimize=True)
    return replace(grid, log_transport=grid.log_transport + change)


def _trust(noise: Array, error: float) -> Array:
    """Return the weight of what has the variance ``noise`` beside what has ``error`` squared."""
    return np.asarray(error**2 / (error**2 + noise))
