"""Normals within the indenter's cone: drawn at random, spread evenly, and angles between them.

A normal is given by its ``tilt``, the part in [0, 1] of the sine of the steepest face, and its
``azimuth`` in rad; even over the cone's disk, as by `render.geometry.layout`.
"""

from __future__ import annotations

import numpy as np

from optimize.design import Array
from render.scene import Scene

GOLDEN_ANGLE = np.pi * (3.0 - 5.0**0.5)


def steepest(scene: Scene) -> float:
    """Return the sine of the steepest normal."""
    return float(np.sin(scene.indenter.slope))


def random_normals(rng: np.random.Generator, shape: tuple[int, ...]) -> tuple[Array, Array]:
    """Return tilts and azimuths of random normals, even over the cone's disk."""
    return np.sqrt(rng.uniform(size=shape)), rng.uniform(0.0, 2 * np.pi, shape)


def spread_normals(states: int, sites: int, count: int) -> tuple[Array, Array]:
    """Return ``count`` tilts and azimuths ``(B, S, count)``, even over the disk (Vogel 1979).

    The spiral is turned from cell to cell, so that all cells together know more azimuths.
    """
    number = np.arange(count)
    tilt = np.sqrt((number + 0.5) / count)
    turn = 2 * np.pi * GOLDEN_ANGLE * np.arange(states * sites).reshape(states, sites, 1)
    return np.broadcast_to(tilt, (states, sites, count)), number * GOLDEN_ANGLE + turn


def plane_parts(slope: float, tilt: Array, azimuth: Array) -> Array:
    """Return the parts ``(..., 2)`` of unit normals along x and y."""
    return slope * np.stack([tilt * np.sin(azimuth), tilt * np.cos(azimuth)], axis=-1)


def vectors(plane: Array) -> Array:
    """Return unit normals ``(..., 3)`` towards the camera, of parts along x and y ``(..., 2)``.

    Parts of more than 1 are shortened to 1.
    """
    plane = plane / np.maximum(np.linalg.norm(plane, axis=-1, keepdims=True), 1.0)
    height = -np.sqrt(np.maximum(1.0 - (plane**2).sum(axis=-1), 0.0))
    return np.concatenate([plane, height[..., None]], axis=-1)


def angle(first: Array, second: Array) -> Array:
    """Return the angle in degrees between unit vectors ``(..., 3)``."""
    half = np.linalg.norm(first - second, axis=-1) / 2
    return np.asarray(np.degrees(2 * np.arcsin(np.minimum(half, 1.0))))


def sphere_metric(plane: Array) -> Array:
    """Return the metric ``(..., 2, 2)`` of the sphere over parts along x and y ``(..., 2)``."""
    height = 1.0 - (plane**2).sum(axis=-1)
    return np.asarray(
        np.eye(2) + plane[..., :, None] * plane[..., None, :] / height[..., None, None]
    )


def guessing_error(scene: Scene) -> float:
    """Return by how many degrees who always says "untouched" misses the same normals on average."""
    part = (np.arange(1000) + 0.5) / 1000  # of the cone's disk, from its middle
    return float(np.degrees(np.arcsin(steepest(scene) * np.sqrt(part))).mean())
