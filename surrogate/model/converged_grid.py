"""The grid of the converged preview: the shader's, times what it misses of the light."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from render.chebyshev import interpolation_weights
from render.preview.converged import NODES, ConvergedTransport
from render.scene import Scene
from surrogate.model.preview_grid import FLOOR, PreviewGrid

BEND_DEGREE = 3
"""In the bend, of the polynomial that corrects the shader's logarithm."""
SHADER_ERROR = 0.15
"""One standard deviation of a cell of the shader's, relative."""


def corrected(grid: PreviewGrid, scene: Scene, found: ConvergedTransport) -> PreviewGrid:
    """Return the shader's grid times the ratio of converged transport to it.

    The ratio at `NODES` and the scene's own bends is the mean of what was found and of 1, weighed
    by their variances: that of the noise, and `SHADER_ERROR` squared. Its logarithm is interpolated
    in direction by the polynomial through `NODES`, in bend by one of degree `BEND_DEGREE` at most,
    constant beyond the scene's own.
    """
    own = np.array(scene.bending.angles)
    drawn = np.exp(grid.evaluate(NODES, own))
    noise = found.grain[..., None, None] / drawn
    trust = SHADER_ERROR**2 / (SHADER_ERROR**2 + noise)
    ratio = np.log1p(trust * (np.maximum(found.cells / drawn, FLOOR) - 1.0))
    in_phi = interpolation_weights(NODES, grid.phi)
    degree = min(len(set(own)) - 1, BEND_DEGREE)
    at_own, at_nodes = (
        np.polynomial.chebyshev.chebvander(at / max(own.max(), 1.0), degree)
        for at in (own, np.clip(grid.bends, own.min(), own.max()))
    )
    in_bend = at_nodes @ np.linalg.pinv(at_own)
    change = np.einsum("pj,qb,fjbsn->fpqsn", in_phi, in_bend, ratio, optimize=True)
    return replace(grid, log_transport=grid.log_transport + change)
