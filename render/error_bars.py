"""Standard errors of transport cells, also of cells that no path has lit yet.

Replicates that all found nothing have no spread, but 0 +- 0 is not what they say. What a run adds
up are rare contributions, a compound Poisson process: variance over mean of a sum is the size of
one contribution (weighted by size), however many there were. Where paths found nothing, fewer than
three contributions are to be expected (the rule of three: e^-3 is 5 %), each taken to be as large
as in cells that are lit by the same fiber from the same direction at other sites. Facets of the
same site would be closer, but share their light subpaths, and so their bad luck.
"""

from __future__ import annotations

import numpy as np

from render.bending import Array

UNLIT = 1.5
"""Contributions in the standard error of an unlit cell: two standard errors are three of them."""
# Axes of the cells whose contributions are looked at: more of them where those are all unlit.
PEERS = ((3, 4), (1, 3, 4), (0, 1, 3, 4), (0, 1, 2, 3, 4))


def standard_error(replicates: Array) -> Array:
    """Return the standard error of the mean over the first axis; above 0 where any cell is lit.

    Arguments:
        replicates: independent estimates ``(replicate, fiber, phi_node, bend, site[, facet])``,
            at least 0; NaN where the camera sees nothing, as is the result then.
    """
    mean = replicates.mean(axis=0)
    error = replicates.std(axis=0, ddof=1) / np.sqrt(len(replicates))
    squared, unlit = error**2, mean == 0
    for axes in PEERS:
        if not unlit.any():
            break
        peers = tuple(axis for axis in axes if axis < mean.ndim)
        variance, light = (np.nansum(a, axis=peers, keepdims=True) for a in (squared, mean))
        size = np.divide(variance, light, out=np.zeros_like(light), where=light > 0)
        error = np.where(unlit, UNLIT * size, error)
        unlit = unlit & (size == 0)
    return np.asarray(error)
