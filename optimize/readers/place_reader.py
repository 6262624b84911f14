"""The *place* reader: the ideal, a lookup that knows the colors of all normals at every place.

It is told site and state and takes the normal whose known color is nearest, as the tables of
Johnson and Adelson (2009) do, but one for each place.
"""

from __future__ import annotations

import numpy as np

from optimize.design import Array
from optimize.readers.camera_model import FULL_SCALE
from optimize.readers.normal_colors import colors_of_normals
from optimize.readers.normals import plane_parts, vectors

TILTS, AZIMUTHS = 24, 72
"""Grid of normals that it knows."""


def look_up(known: Array, seen: Array, slope: float) -> Array:
    """Return the normals ``(B, S, n, 3)`` whose known colors are nearest to ``seen``.

    ``known`` ``(B, S, facet + 1, C)`` are colors of facets and untouched pad, ``seen``
    ``(B, S, n, C)`` what the camera recorded, both in counts; ``slope`` is the sine of the
    steepest normal.
    """
    from scipy.spatial import cKDTree

    states, sites = seen.shape[:2]
    tilt, azimuth = np.meshgrid(
        np.linspace(0.0, 1.0, TILTS),
        2 * np.pi * np.arange(AZIMUTHS) / AZIMUTHS,
        indexing="ij",
    )
    table = np.minimum(colors_of_normals(known, tilt.ravel(), azimuth.ravel()), FULL_SCALE)
    normals = vectors(plane_parts(slope, tilt.ravel(), azimuth.ravel()))
    found = np.empty((*seen.shape[:3], 3))
    for state in range(states):
        for site in range(sites):
            _, index = cKDTree(table[state, site]).query(seen[state, site])
            found[state, site] = normals[index]
    return found
