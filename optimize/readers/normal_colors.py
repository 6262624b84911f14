"""Colors of any normal within the indenter's cone, from those of its facets.

With the azimuth a and the tilt r in [0, 1] the counts are
``c_0 + r^2 (mean - c_0) + sum_k r^k (a_k cos k a + b_k sin k a)``, k = 1 .. 3: harmonics of the
facets' colors (eq. 4.2 has k = 1; the others are shadows), smooth at the untouched pad c_0. So they
are a weighted sum of the colors of the facets and, last, of the untouched pad.
"""

from __future__ import annotations

import numpy as np

from optimize.design import Array

HARMONICS = 3


def color_weights(facets: int, tilt: Array, azimuth: Array) -> Array:
    """Return the weights ``(..., n, facet + 1)`` of normals ``(..., n)``, the pad's last."""
    orders = np.arange(1, min(HARMONICS, (facets - 1) // 2) + 1)
    turn = azimuth[..., None] - 2 * np.pi * np.arange(facets) / facets
    waves = tilt[..., None, None] ** orders * np.cos(turn[..., None] * orders)
    weights = (tilt[..., None] ** 2 + 2.0 * waves.sum(axis=-1)) / facets
    return np.concatenate([weights, 1.0 - tilt[..., None] ** 2], axis=-1)


def weight_slopes(facets: int, tilt: Array, azimuth: Array, slope: float) -> Array:
    """Return derivatives ``(..., n, facet + 1, 2)`` of `color_weights` by parts along x and y.

    ``slope`` is the sine of the steepest normal; ``tilt`` is above 0.
    """
    orders = np.arange(1, min(HARMONICS, (facets - 1) // 2) + 1)
    turn = (azimuth[..., None] - 2 * np.pi * np.arange(facets) / facets)[..., None] * orders
    power = orders * tilt[..., None, None] ** (orders - 1)
    along = 2.0 * (tilt[..., None] + (power * np.cos(turn)).sum(axis=-1)) / facets
    along = np.concatenate([along, -2.0 * tilt[..., None]], axis=-1)
    across = -2.0 * (power * np.sin(turn)).sum(axis=-1) / facets
    across = np.concatenate([across, np.zeros((*tilt.shape, 1))], axis=-1)
    sine, cosine = np.sin(azimuth)[..., None], np.cos(azimuth)[..., None]
    return np.stack([along * sine + across * cosine, along * cosine - across * sine], -1) / slope


def colors_of_normals(colors: Array, tilt: Array, azimuth: Array) -> Array:
    """Return counts ``(B, S, n, C)`` of normals ``(B, S, n)``, not clipped.

    ``colors`` ``(B, S, facet + 1, C)`` are those of the facets and, last, of the untouched pad.
    """
    weights = color_weights(colors.shape[2] - 1, tilt, azimuth)
    return np.asarray(np.maximum(weights @ colors, 0.0))
