"""The colors of the untouched pad at the sites, from a photograph."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hw.camera.projection import pad_positions
from render.arrays import Array
from render.geometry import flat_sites
from tactilux import Scene

RADIUS = 1.0
"""Radius (mm) of the spot that is averaged: far more pixels than the model's own spots have, and
on the untouched pad light changes little over it."""


class SiteSpots:
    """Which pixels show each site's spot at a bend; made once, used for every photograph.

    Arguments:
        scene: the sensor; photographs have its camera's columns and rows.
        bend: rad.
    """

    def __init__(self, scene: Scene, bend: float) -> None:
        """Find the pixels."""
        rows, columns = scene.camera.rows, scene.camera.columns
        flat = pad_positions(scene, bend, rows, columns).reshape(-1, 2)
        self._pixels: list[NDArray[np.int64]] = []
        for site in flat_sites(scene)[:, :2]:
            away = np.hypot(*(flat - site).T)
            self._pixels.append(np.nonzero(away <= RADIUS)[0])

    @property
    def counts(self) -> NDArray[np.int64]:
        """Pixels per site, ``(site,)``."""
        return np.array([len(pixels) for pixels in self._pixels])

    def colors(self, photo: Array) -> Array:
        """Return mean colors ``(site, 3)`` of ``photo`` ``(row, column, 3)``; NaN where unseen."""
        flat = photo.reshape(-1, 3)
        return np.stack(
            [
                flat[pixels].mean(axis=0) if len(pixels) else np.full(3, np.nan)
                for pixels in self._pixels
            ]
        )
