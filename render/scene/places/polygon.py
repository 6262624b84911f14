"""Polygons of a plane: what lies inside, how far from the border, and whether sides cross; mm."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from render.arrays import Array

MOST_CORNERS = 64
"""All pairs of sides are held against each other."""


def inside(points: Array, corners: Array) -> NDArray[np.bool_]:
    """Return which of ``points`` ``(..., 2)`` lie in a polygon ``(corner, 2)``.

    A ray to the right meets the border an odd number of times (Shimrat 1962).

    >>> inside(np.array([[1.0, 1.0], [3.0, 1.0]]), np.array([[0, 0], [2, 0], [2, 2], [0, 2.0]]))
    array([ True, False])
    """
    x, y = np.asarray(points)[..., None, 0], np.asarray(points)[..., None, 1]
    (x0, y0), (x1, y1) = corners.T, np.roll(corners, -1, axis=0).T
    spans = (y0 > y) != (y1 > y)
    with np.errstate(divide="ignore", invalid="ignore"):
        meets = x < x0 + (y - y0) * (x1 - x0) / (y1 - y0)
    return np.asarray((spans & meets).sum(axis=-1) % 2 == 1)


def border_distance(points: Array, corners: Array) -> Array:
    """Return how far ``points`` ``(..., 2)`` are from the nearest side, ``(...)``."""
    start, way = corners, np.roll(corners, -1, axis=0) - corners
    from_start = np.asarray(points)[..., None, :] - start
    part = (from_start * way).sum(axis=-1) / np.maximum((way**2).sum(axis=-1), 1e-30)
    nearest = from_start - np.clip(part, 0.0, 1.0)[..., None] * way
    return np.asarray(np.linalg.norm(nearest, axis=-1).min(axis=-1))


def polygon_problems(corners: Array, key: str) -> Iterator[str]:
    """Yield why there is no polygon of such ``corners`` ``(corner, 2)``."""
    count = len(corners)
    if not 3 <= count <= MOST_CORNERS:
        said = f"{key} has {count} corner{'s' * (count != 1)}"
        yield f"{said}, allowed: 3 to {MOST_CORNERS}, going around"
        return
    ends = np.roll(corners, -1, axis=0)
    for first, second in itertools.combinations(range(count), 2):
        if second - first in (1, count - 1):
            continue
        if _cross(corners[first], ends[first], corners[second], ends[second]):
            yield (
                f"{key}: the sides after corners {first} and {second} meet, allowed: corners in "
                "their order around it"
            )
            return
    if abs(float(_turn(corners, ends).sum())) < 1e-9:
        yield f"{key} enclose no area, allowed: at least 3 corners that are not on a line"


def _turn(first: Array, second: Array) -> Array:
    return np.asarray(first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0])


def _cross(a: Array, b: Array, c: Array, d: Array) -> bool:
    """Return whether segments ``a b`` and ``c d`` share a point."""
    if min(border_distance(end, np.stack(side)) for end, side in (
        (a, (c, d)), (b, (c, d)), (c, (a, b)), (d, (a, b))
    )) < 1e-9:  # fmt: skip
        return True
    return bool(
        _turn(b - a, c - a) * _turn(b - a, d - a) < 0.0
        and _turn(d - c, a - c) * _turn(d - c, b - c) < 0.0
    )
