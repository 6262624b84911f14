"""The basis of the slab response: which point lights, and which directional distributions."""

from __future__ import annotations

import numpy as np

from render.arrays import Array

TERMS = 9
MIRROR_ALONG = np.array([1, -1, 1, 1, -1, 1, 1, -1, 1])
"""Signs of the terms when the direction along the edge is reversed."""


def directional_terms(direction: Array) -> Array:
    """Return ``1, a, z, a^2, a z, z^2, d, d a, d z`` ``(..., 9)`` of unit vectors ``(a, d, z)``.

    They span the spherical harmonics up to degree 2: along the edge, into the pad, upwards.
    """
    a, d, z = direction[..., 0], direction[..., 1], direction[..., 2]
    one = np.ones_like(a)
    return np.stack([one, a, z, a * a, a * z, z * z, d, d * a, d * z], axis=-1)


def moments() -> Array:
    """Return the integrals ``(9, 9)`` of products of terms times the cosine over the hemisphere."""
    cosine, weight = np.polynomial.legendre.leggauss(8)
    direction = hemisphere(0.5 * (cosine + 1), 16)
    terms = directional_terms(direction)
    weight = 0.5 * weight * direction[:, 0, 1] * 2 * np.pi / 16
    return np.asarray(np.einsum("c,cak,cal->kl", weight, terms, terms))


def hemisphere(cosine: Array, count: int) -> Array:
    """Return directions ``(cosine, count, 3)`` evenly spaced in azimuth about the inward normal."""
    azimuth = 2 * np.pi * np.arange(count) / count
    sin = np.sqrt(1 - cosine**2)[:, None]
    rings = (sin * np.cos(azimuth), cosine[:, None], sin * np.sin(azimuth))
    return np.stack(np.broadcast_arrays(*rings), axis=-1)


def linear_weights(x: Array, nodes: Array) -> Array:
    """Return ``(x, node)`` weights that share ``x`` between its neighbors; ends hold the rest."""
    cell = np.clip(np.searchsorted(nodes, x) - 1, 0, len(nodes) - 2)
    fraction = np.clip((x - nodes[cell]) / (nodes[cell + 1] - nodes[cell]), 0.0, 1.0)
    weights = np.zeros((len(x), len(nodes)))
    rows = np.arange(len(x))
    weights[rows, cell] = 1 - fraction
    weights[rows, cell + 1] = fraction
    return weights


def nonnegative(radiance: Array) -> Array:
    """Blend lights towards diffuse ones of the same power until none is negative anywhere."""
    terms = directional_terms(hemisphere(np.linspace(0.0, 1.0, 12), 24)).reshape(-1, TERMS)
    minimum = np.min(radiance @ terms.T, axis=-1)
    diffuse = np.maximum(radiance @ moments()[0] / np.pi, 0.0)
    fraction = np.where(minimum < 0, diffuse / np.maximum(diffuse - minimum, 1e-300), 1.0)[
        ..., None
    ]
    return np.asarray(fraction * radiance + (1 - fraction) * diffuse[..., None] * np.eye(TERMS)[0])
