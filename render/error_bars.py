"""Standard errors of transport cells from replicates, also of cells that no path has lit yet.

What a run adds up are rare contributions, a compound Poisson process: the variance of a mean over
the mean is the size of one contribution (weighted by size), however many there were. That size is
nearly the same for the facets of one site, which share their light subpaths, and is taken from all
of them. A cell's own spread would be an error bar that is short where the cell came out dark:
intervals from 8 replicates missed too much light that was still to be found.

Replicates that all found nothing say that fewer than three contributions are to be expected (the
rule of three: e^-3 is 5 %), each taken to be as large as in cells that are lit by the same fiber
from the same direction at other sites: those of the same site share its bad luck.
"""

from __future__ import annotations

import numpy as np

from render.bending import Array

FACETS = (4,)
# Axes of the cells whose contributions an unlit one borrows: more where those are unlit too.
PEERS = ((3, 4), (1, 3, 4), (0, 1, 3, 4), (0, 1, 2, 3, 4))
UNLIT = 1.5
"""Contributions in the standard error of an unlit cell: two standard errors are three of them."""


def standard_error(replicates: Array) -> Array:
    """Return the standard error of the mean over the first axis; above 0 where any cell is lit.

    Arguments:
        replicates: independent estimates ``(replicate, fiber, phi_node, bend, site[, facet])``,
            at least 0; NaN where the camera sees nothing, as is the result then.
    """
    mean = replicates.mean(axis=0)
    variance = replicates.var(axis=0, ddof=1) / len(replicates)
    error = np.sqrt(mean * _contribution(mean, variance, FACETS))
    unlit = mean == 0
    for axes in PEERS:
        if not unlit.any():
            break
        size = _contribution(mean, variance, axes)
        error = np.where(unlit, UNLIT * size, error)
        unlit = unlit & (size == 0)
    return np.asarray(error)


def _contribution(mean: Array, variance: Array, axes: tuple[int, ...]) -> Array:
    """Return the size of one contribution over ``axes`` of the cells; 0 where all are unlit."""
    present = tuple(axis for axis in axes if axis < mean.ndim)
    light, spread = (np.nansum(a, axis=present, keepdims=True) for a in (mean, variance))
    return np.asarray(np.divide(spread, light, out=np.zeros_like(light), where=light > 0))
