"""Chebyshev nodes and barycentric interpolation: how transport depends on a continuous angle."""

from __future__ import annotations

import numpy as np

from render.arrays import Array


def chebyshev_nodes(count: int, low: float, high: float) -> Array:
    """Return ``count`` ascending Chebyshev points of the second kind on ``[low, high]``.

    Both ends are nodes, so phi = 0, phi = pi and the unbent pad are never extrapolated.
    """
    if count == 1:
        return np.array([0.5 * (low + high)])
    x = -np.cos(np.pi * np.arange(count) / (count - 1))
    nodes = low + 0.5 * (high - low) * (x + 1.0)
    nodes[0], nodes[-1] = low, high
    return np.asarray(nodes)


def interpolation_weights(nodes: Array, x: Array) -> Array:
    """Return the weights ``(..., node)`` that interpolate values at ``nodes`` to ``x`` ``(...)``.

    Barycentric Lagrange interpolation (Berrut and Trefethen 2004, eq. 4.2), stable for any
    distinct nodes; exact at a node. float64; the weights sum to 1. ``x`` must lie within the
    nodes' range: the caller validates it.
    """
    x = np.asarray(x, dtype=np.float64)
    if len(nodes) == 1:
        return np.ones((*x.shape, 1))
    span = 4.0 / (nodes.max() - nodes.min())
    gaps = span * (nodes[:, None] - nodes[None, :])
    np.fill_diagonal(gaps, 1.0)
    barycentric = 1.0 / gaps.prod(axis=1)
    distance = x[..., None] - nodes
    # Closer than this, 1 / distance overflows; the value is that of the node.
    hit = np.abs(distance) < 1e-200
    terms = barycentric / np.where(hit, 1.0, distance)
    terms = np.where(hit.any(axis=-1, keepdims=True), hit, terms)
    return np.asarray(terms / terms.sum(axis=-1, keepdims=True))


def differentiation_matrix(nodes: Array) -> Array:
    """Return D ``(node, node)``: derivatives at the nodes of the polynomial through values there.

    ``D_ij = (w_j / w_i) / (x_i - x_j)`` with barycentric weights w, and rows that sum to 0
    (Berrut and Trefethen 2004, eqs. 9.4 and 9.5); float64. One node has derivative 0.
    """
    if len(nodes) == 1:
        return np.zeros((1, 1))
    gaps = nodes[:, None] - nodes[None, :]
    scaled = 4.0 / (nodes.max() - nodes.min()) * gaps
    np.fill_diagonal(scaled, 1.0)
    weights = 1.0 / scaled.prod(axis=1)
    np.fill_diagonal(gaps, 1.0)
    matrix = weights[None, :] / weights[:, None] / gaps
    np.fill_diagonal(matrix, 0.0)
    np.fill_diagonal(matrix, -matrix.sum(axis=1))
    return np.asarray(matrix)
