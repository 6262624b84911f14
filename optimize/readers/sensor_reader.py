"""The *sensor* reader: one smooth map from color and place to normal for the whole sensor.

It stands for what people train, one small network that is told color and pixel and not the bend
(Wang et al. 2021, GelSight Wedge; Lambeta et al. 2020, DIGIT): ridge regression on monomials of
color (degree 3) times monomials of place (degree 2).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from optimize.design import Array
from optimize.readers.normals import vectors
from optimize.readers.polynomials import monomials
from render.geometry import flat_sites
from render.scene import Scene

COLOR_DEGREE, PLACE_DEGREE = 3, 2
RIDGE = 1e-6
"""Weight of the penalty, relative to the number of examples; colors have unit variance."""
CACHED = 2000
"""Colors whose monomials fit into a processor's cache: a third of the time of all at once."""
LEAST_DEVIATION = 1.0
"""Counts; a channel that varies less is not stretched further."""


def site_places(scene: Scene) -> Array:
    """Return the place of each site ``(site, 2)`` in halves of the pad's width and length."""
    return np.asarray(flat_sites(scene)[:, :2] / [scene.pad.width / 2, scene.pad.length / 2])


@dataclass(frozen=True, eq=False)
class SensorReader:
    """A fitted reader: ``center`` and ``scale`` ``(C,)`` counts, ``weights`` ``(F, 2)``."""

    center: Array
    scale: Array
    weights: Array
    place_degree: int = PLACE_DEGREE

    @classmethod
    def fit(
        cls, colors: Array, place: Array, plane: Array, place_degree: int = PLACE_DEGREE
    ) -> SensorReader:
        """Return the reader that examples ``(n, C)``, ``(n, 2)`` and ``(n, 2)`` teach.

        ``colors`` in counts, ``place`` as `site_places`, ``plane`` the normals' parts along x and
        y.
        """
        center, scale = colors.mean(axis=0), np.maximum(colors.std(axis=0), LEAST_DEVIATION)
        known = _features((colors - center) / scale, place, place_degree)
        gram = known.T @ known + RIDGE * len(known) * np.eye(known.shape[1])
        return cls(center, scale, np.asarray(np.linalg.solve(gram, known.T @ plane)), place_degree)

    def read(self, colors: Array, place: Array) -> Array:
        """Return unit normals ``(n, 3)`` of ``colors`` ``(n, C)`` at ``place`` ``(n, 2)``."""
        return vectors(self.at(place).plane(colors))

    def at(self, place: Array) -> PlacedReader:
        """Return the reader of the places ``(n, 2)`` alone, for many pictures of the same."""
        known = monomials(place, self.place_degree)
        weights = known @ self.weights.reshape(known.shape[1], -1)
        return PlacedReader(self, weights.reshape(len(place), -1, 2))


@dataclass(frozen=True, eq=False)
class PlacedReader:
    """A reader at fixed places: ``weights`` ``(n, color monomial, 2)``."""

    reader: SensorReader
    weights: Array

    def plane(self, colors: Array) -> Array:
        """Return the normals' parts along x and y ``(n, 2)`` of ``colors`` ``(n, C)``."""
        known = (colors - self.reader.center) / self.reader.scale
        read = np.empty((len(colors), 2))
        for first in range(0, len(colors), CACHED):
            part = slice(first, first + CACHED)
            terms = monomials(known[part], COLOR_DEGREE)[:, None]
            read[part] = (terms @ self.weights[part])[:, 0]
        return read


def _features(colors: Array, place: Array, degree: int) -> Array:
    """Return place times color monomials, ``(n, F)``."""
    both = monomials(place, degree)[:, :, None] * monomials(colors, COLOR_DEGREE)[:, None]
    return both.reshape(len(colors), -1)
