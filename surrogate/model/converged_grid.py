"""The grid that traced light corrects: the shader's, times what it misses of the light."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import wrightomega

from render.arrays import Array
from render.chebyshev import chebyshev_nodes, interpolation_weights
from render.preview.converged import ConvergedTransport
from render.scene import Scene
from surrogate.model.lamp_copies import split_channels
from surrogate.model.preview_grid import FLOOR, PreviewGrid

BEND_DEGREE = 3
"""In the bend, of the polynomial that corrects the shader's logarithm."""
LAMP_ERROR, SITE_ERROR, CELL_ERROR = 0.6, 0.6, 0.4
"""One standard deviation of the logarithm of the shader's light of a lamp in one direction at one
bend; of that of one of its sites, once the lamp's is right; of that of a cell, once the site's is.
"""


def corrected(grid: PreviewGrid, scene: Scene, found: ConvergedTransport) -> PreviewGrid:
    """Return the shader's grid times the ratio of converged transport to it.

    At its nodes and the scene's own bends, the light of a lamp, then of each of its sites, then of
    each cell is the `likely_ratio` of what was found to what is expected: the shader's light times
    the ratios before, with `LAMP_ERROR`, `SITE_ERROR` and `CELL_ERROR`. The ratio of a cell is the
    product of the three; where light has no grain it is what was found over the shader's. Its
    logarithm is interpolated in direction by the polynomial through them, in bend by one of
    degree `BEND_DEGREE` at most, constant beyond the scene's own; each state has its own.
    """
    own = np.array(scene.state_axis)
    nodes = chebyshev_nodes(found.cells.shape[1], 0.0, np.pi)
    drawn = np.exp(grid.evaluate(nodes, own))
    grain = split_channels(scene, found.grain)[..., None, None]
    light = split_channels(scene, found.cells)
    # Facets of a site share photons: a lamp's light is known as well as that of its sites.
    shared = drawn.shape[-1] * grain
    cells = np.ones_like(grain)
    for axes, noise, error in (
        ((3, 4), shared, LAMP_ERROR),
        ((4,), shared, SITE_ERROR),
        ((), grain, CELL_ERROR),
    ):
        expected = (drawn * cells).sum(axis=axes, keepdims=True)
        cells = cells * likely_ratio(light.sum(axis=axes, keepdims=True), expected, noise, error)
    ratio = np.log(np.maximum(cells, FLOOR))
    in_phi = interpolation_weights(nodes, grid.phi)
    if scene.states is None:
        degree = min(len(set(own)) - 1, BEND_DEGREE)
        at_own, at_nodes = (
            np.polynomial.chebyshev.chebvander(at / max(own.max(), 1.0), degree)
            for at in (own, np.clip(grid.bends, own.min(), own.max()))
        )
        in_bend = at_nodes @ np.linalg.pinv(at_own)
    else:
        in_bend = np.eye(len(own))  # there is nothing between states
    change = np.einsum("pj,qb,fjbsn->fpqsn", in_phi, in_bend, ratio, optimize=True)
    noise = float(np.max(found.noise))
    return replace(grid, log_transport=grid.log_transport + change, photon_noise=noise)


def likely_ratio(found: Array, expected: Array, grain: Array, error: float) -> Array:
    """Return the likeliest ratio r of the light to what is ``expected`` of it, given ``found``.

    In units of ``grain``, the light of a photon, ``n`` are found of ``m r``. They are Poisson
    distributed, and log r is normal around 0 with standard deviation s = ``error``; its tails are
    wide enough for light that the shader lacks ten times over, which those of a gamma distribution
    are not. The most probable log r solves ``n - m r - log r / s^2 = 0``, so
    ``s^2 m r = omega(log(s^2 m) + s^2 n)`` with Wright's omega, ``omega + log omega = z``
    (Corless and Jeffrey 2002). Where the grain is 0, r is what was found over what is expected.
    """
    found, expected, grain = np.broadcast_arrays(found, expected, grain)
    ratio, grainy = found / expected, grain > 0.0
    photons = error**2 * found[grainy] / grain[grainy]
    wanted = error**2 * expected[grainy] / grain[grainy]
    ratio[grainy] = wrightomega(np.log(wanted) + photons) / wanted
    return np.asarray(ratio)
