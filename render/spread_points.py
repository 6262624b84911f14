"""Evenly spread points, where independent ones would leave holes."""

from __future__ import annotations

import numpy as np

from render.arrays import Array


def spread_points(numbers: range, dimensions: int, key: int) -> Array:
    """Return points ``(point, dimension)`` in [0, 1) of a sequence that is shifted by chance.

    Roberts' additive sequence: multiples of powers of the root of ``x^(d + 1) = x + 1``, of which
    ``numbers`` says which; ``key`` chooses the shift.
    """
    root = 2.0
    for _ in range(60):
        root = (1.0 + root) ** (1.0 / (dimensions + 1))
    shift = np.random.Generator(np.random.Philox(key=key)).random(dimensions)
    steps = root ** -np.arange(1.0, dimensions + 1)
    points = shift + np.arange(numbers.start, numbers.stop, numbers.step)[:, None] * steps
    points -= np.floor(points)  # what % 1.0 is, exactly, in a quarter of the time
    return points
