"""Depth from normals: slopes of a picture are integrated over the pad, whose border is known.

The skin is held at the pad's edges, so its depth there is 0: least squares then lead to Poisson's
equation with that border, which sines solve directly (Simchony, Chellappa and Shao 1990; GelSight
integrates so too: Yuan, Dong and Adelson 2017).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from optimize.design import Array
from render.geometry import aim_at, camera_origin, pixel_positions, refract_into_pad
from render.scene import Scene

PERSPECTIVE_STEPS = 8
"""How often depth is put into the equation for itself; each divides what is left by ten or so."""


EXACT = 1e-5
"""Change in mm below which it ends."""


def integrated(slopes: Array, step: tuple[float, float]) -> Array:
    """Return the depth ``(row, column)`` in mm whose slopes are nearest, 0 on the border.

    What neighbors differ by is, in least squares, their distance times the mean of their slopes.

    Arguments:
        slopes: ``(2, row, column)``, the depth's derivatives along columns (x) and rows (y).
        step: distance of columns and of rows, mm.
    """
    from scipy.fft import dstn, idstn

    along_x, along_y = slopes
    dx, dy = step
    # Mean slopes between neighbors; their divergence at the points within the border.
    between_x = 0.5 * (along_x[1:-1, 1:] + along_x[1:-1, :-1])
    between_y = 0.5 * (along_y[1:, 1:-1] + along_y[:-1, 1:-1])
    bent = np.diff(between_x, axis=1) / dx + np.diff(between_y, axis=0) / dy
    rows, columns = bent.shape
    wave_x = 2.0 * (np.cos(np.pi * np.arange(1, columns + 1) / (columns + 1)) - 1.0) / dx**2
    wave_y = 2.0 * (np.cos(np.pi * np.arange(1, rows + 1) / (rows + 1)) - 1.0) / dy**2
    inside = idstn(dstn(bent, type=1) / (wave_x + wave_y[:, None]), type=1)
    return np.pad(np.asarray(inside), 1)


@dataclass(frozen=True, eq=False)
class SeenGrid:
    """A grid over the pad, edges included, and where a picture of a flat skin has its points.

    Arguments:
        step: distance of columns and of rows, mm.
        place: column and row of each point in the picture, pixels, ``(2, row, column)``; the
            picture is that of `Preview.picture`, and the middle of its first pixel is (0, 0).
        seen: whether the picture has the point, ``(row, column)``.
        lean: mm along x and y that its line of sight goes per mm up, ``(2, row, column)``.
    """

    step: tuple[float, float]
    place: Array
    seen: NDArray[np.bool_]
    lean: Array

    @classmethod
    def of(cls, scene: Scene, x: Array, y: Array, size: tuple[int, int]) -> SeenGrid:
        """Return the grid of the lines ``x`` and ``y`` (mm); ``size`` is columns and rows."""
        columns, rows = size
        across, along = np.meshgrid(x, y)
        origin = camera_origin(scene)
        points = np.stack([across, along, np.full(across.shape, scene.pad.thickness)], axis=-1)
        aim, hit = aim_at(scene, 0.0, origin, points.reshape(-1, 3))
        inside = refract_into_pad(scene, 0.0, origin, aim).direction
        position = pixel_positions(scene, columns, rows, aim)
        # The camera looks from within; pictures are drawn as from outside.
        place = np.stack([columns - position[:, 0], position[:, 1]]) - 0.5
        end = np.array([columns, rows])[:, None] - 1.0
        seen = hit & ((place >= 0.0) & (place <= end)).all(axis=0)
        lean = (inside[:, :2] / inside[:, 2:]).T
        shape = across.shape
        return cls(
            (float(x[1] - x[0]), float(y[1] - y[0])),
            place.reshape(2, *shape),
            seen.reshape(shape),
            lean.reshape(2, *shape),
        )

    def depth(self, slopes: Array) -> Array:
        """Return the depth ``(row, column)`` in mm of what a picture's pixels read.

        What no pixel sees counts as untouched. A pixel sees the pressed skin beside the place at
        which it saw the untouched one, by depth times `lean`.

        ``slopes`` ``(2, row, column)`` of the depth along x and y, for the picture's pixels.
        """
        from scipy.ndimage import map_coordinates

        depth, (dx, dy) = self.along_sight(slopes), self.step
        row, column = np.indices(depth.shape, dtype=np.float64)
        moved = depth
        for _ in range(PERSPECTIVE_STEPS):
            before, aside = moved, moved * self.lean
            moved = map_coordinates(depth, [row + aside[1] / dy, column + aside[0] / dx], order=1)
            if np.abs(moved - before).max() < EXACT:
                break
        return np.asarray(moved)

    def along_sight(self, slopes: Array, steps: int = PERSPECTIVE_STEPS) -> Array:
        """Return `depth` where the untouched skin was seen; its peaks are as high.

        With D there, g the slopes and s the lean, ``grad D = (g - D (ds/du)^T g) / (1 + g s)``,
        which is integrated in turns. One of the ``steps`` is enough for depths of micrometers.
        """
        from scipy.ndimage import map_coordinates

        read = np.array([map_coordinates(one, self.place[::-1], order=1) for one in slopes])
        read[:, ~self.seen] = 0.0
        sheared = (self._turn * read).sum(axis=1)
        tilted = 1.0 + (read * self.lean).sum(axis=0)
        depth = np.zeros(self.seen.shape)
        for _ in range(steps):
            before = depth
            depth = integrated((read - depth * sheared) / tilted, self.step)
            if np.abs(depth - before).max() < EXACT:
                break
        return depth

    @cached_property
    def _turn(self) -> Array:
        """Derivatives of `lean` along x and y, ``(2, lean, row, column)``."""
        dx, dy = self.step
        return np.stack([np.gradient(self.lean, dx, axis=2), np.gradient(self.lean, dy, axis=1)])
