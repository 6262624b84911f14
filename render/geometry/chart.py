"""The chart of the skin: where its points are, how they are turned, and which point one is.

A point of the skin has coordinates ``uv``: its x and y on the flat block, mm. What is pressed into
the skin, what stands on it and what looks at it ask the chart of a state, here a bend, for

- `SkinChart.points`: where ``uv`` is in the world,
- `SkinChart.frames`: across, towards the tip and out of the pad there,
- `SkinChart.uv`: which point of the skin a world point is,
- `SkinChart.way`: how far light inside the pad goes to it.

The pad's body (lamps, lower face, edges) is carried by `render.geometry.bending`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from render.arrays import Array
from render.geometry.bending import (
    bend_frames,
    bend_points,
    curvature,
    distance_to_arc,
    unbend_points,
)
from render.scene import Scene


@dataclass(frozen=True)
class SkinChart:
    """The skin of one scene in one state: at ``bend`` radians."""

    scene: Scene
    bend: float

    def flat(self, uv: Array) -> Array:
        """Return positions ``(..., 3)`` mm on the flat block of points ``uv`` ``(..., 2)``."""
        level = np.full((*uv.shape[:-1], 1), self.scene.pad.thickness)
        return np.concatenate([uv, level], axis=-1)

    def points(self, uv: Array) -> Array:
        """Return world positions ``(..., 3)`` mm of points ``uv`` ``(..., 2)``."""
        return bend_points(self.scene, self.flat(uv), self.bend)

    def frames(self, uv: Array) -> Array:
        """Return rotations ``(..., 3, 3)`` from the skin's frames at ``uv`` ``(..., 2)``.

        Column 0 is across (+x), column 1 towards the tip, column 2 out of the pad.
        """
        return bend_frames(self.scene, uv[..., 1], self.bend)

    def uv(self, world: Array) -> Array:
        """Return the coordinates ``(..., 2)`` of world points ``(..., 3)`` on the skin."""
        return unbend_points(self.scene, world, self.bend)[..., :2]

    def way(self, start: Array, direction: Array) -> Array:
        """Return the way (mm) to the untouched skin, ``inf`` where a ray passes it.

        Rays go from ``start`` ``(..., 3)`` inside the pad along unit vectors ``direction``.
        """
        local = start - [0.0, self.scene.camera.pivot, self.scene.pad.thickness]
        return distance_to_arc(curvature(self.scene, self.bend), local, direction)
