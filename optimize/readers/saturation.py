"""From which tilt on a channel saturates, which says how steep a contact may be."""

from __future__ import annotations

import numpy as np

from optimize.design import Array
from optimize.readers.camera_model import FULL_SCALE
from optimize.readers.normal_colors import colors_of_normals
from optimize.readers.normals import steepest
from render.scene import Scene

TILTS, AZIMUTHS = 46, 36
"""Grid of normals from the untouched pad to the indenter's slope, and around."""


def saturating_tilts(scene: Scene, colors: Array) -> tuple[float | None, ...]:
    """Return the least tilt in degrees at which each channel reaches full scale somewhere.

    ``colors`` ``(B, S, facet + 1, C)`` are exposed counts of facets and untouched pad, not
    clipped. None where a channel never does within the indenter's slope.
    """
    share = np.linspace(0.0, 1.0, TILTS)
    azimuth = 2 * np.pi * np.arange(AZIMUTHS) / AZIMUTHS
    grid = np.meshgrid(share, azimuth, indexing="ij")
    counts = colors_of_normals(colors, *(part.ravel() for part in grid))
    counts = counts.reshape(-1, TILTS, AZIMUTHS, colors.shape[-1])
    full = np.asarray((counts >= FULL_SCALE).any(axis=(0, 2)))
    tilts = np.degrees(np.arcsin(steepest(scene) * share))
    return tuple(
        float(tilts[int(full[:, i].argmax())]) if full[:, i].any() else None
        for i in range(full.shape[1])
    )
