"""The chart of the skin: where its points are, how they are turned, and which point one is.

A point of the skin has coordinates ``uv``: its x and y on the flat block, mm. What is pressed into
the skin, what stands on it and what looks at it ask the chart of a state, here a bend, for

- `SkinChart.points`: where ``uv`` is in the world,
- `SkinChart.frames`: across, towards the tip and out of the pad there,
- `SkinChart.uv`: which point of the skin a world point is,
- `SkinChart.way`: how far light inside the pad goes to it.

The pad's body (lamps, lower face, edges) is carried by `render.geometry.bending`. A skin that is
not flat is a height over the flat block (`render.scene.skin`, which says how to add a shape), and
does not bend. Where it has named states, this is the chart of the skin in one of them; by the
coordinates that its points have at rest it is `render.geometry.states.StateChart`.
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

STEPS, HALVINGS = 24, 30
"""Steps in which a ray looks for the first crossing of a skin, and bisections that find it."""
ROUNDING = 1e-12
"""mm by which a ray that ends on the skin may miss it."""


@dataclass(frozen=True)
class SkinChart:
    """The skin of one scene in one state: at ``bend`` radians."""

    scene: Scene
    bend: float

    def flat(self, uv: Array) -> Array:
        """Return positions ``(..., 3)`` mm on the flat block of points ``uv`` ``(..., 2)``."""
        return np.concatenate([uv, self.height(uv)[..., None]], axis=-1)

    def height(self, uv: Array) -> Array:
        """Return the height of the skin over the lower face of the flat block, mm."""
        level = np.full(uv.shape[:-1], self.scene.pad.thickness)
        skin = self.scene.skin
        return level if skin is None else level + skin.rise(uv[..., 0], uv[..., 1])

    def points(self, uv: Array) -> Array:
        """Return world positions ``(..., 3)`` mm of points ``uv`` ``(..., 2)``."""
        return bend_points(self.scene, self.flat(uv), self.bend)

    def frames(self, uv: Array) -> Array:
        """Return rotations ``(..., 3, 3)`` from the skin's frames at ``uv`` ``(..., 2)``.

        Column 0 is across (+x), column 1 towards the tip, column 2 out of the pad.
        """
        turn = bend_frames(self.scene, uv[..., 1], self.bend)
        skin = self.scene.skin
        return turn if skin is None else turn @ _sloping(*skin.slope(uv[..., 0], uv[..., 1]))

    def uv(self, world: Array) -> Array:
        """Return the coordinates ``(..., 2)`` of world points ``(..., 3)`` on the skin."""
        return unbend_points(self.scene, world, self.bend)[..., :2]

    def way(self, start: Array, direction: Array) -> Array:
        """Return the way (mm) to the untouched skin, ``inf`` where a ray passes it.

        Rays go from ``start`` ``(..., 3)`` inside the pad along unit vectors ``direction``.
        """
        if self.scene.skin is not None:
            return self._way_to_height(start, direction)
        local = start - [0.0, self.scene.camera.pivot, self.scene.pad.thickness]
        return distance_to_arc(curvature(self.scene, self.bend), local, direction)

    def _way_to_height(self, start: Array, direction: Array) -> Array:
        """Return `way` to a height over the block: the first of `STEPS` in which a ray crosses it.

        Rays end at the crown's level, and at the edges.
        """
        pad = self.scene.pad
        high = np.array([pad.width / 2, pad.length / 2, pad.thickness])
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = np.where(direction > 0, high - start, [-1, -1, -np.inf] * high - start)
            last = np.where(direction == 0, np.inf, ends / direction).min(axis=-1)
        going = np.isfinite(last) & (last > 0)
        last = np.where(going, last, 0.0)

        def above(way: Array) -> Array:
            place = start + way[..., None] * direction
            return np.asarray(place[..., 2] - self.height(place[..., :2]))

        before, after = np.zeros_like(last), last
        met = np.zeros(last.shape, dtype=bool)
        for step in range(1, STEPS + 1):
            here = last * (step / STEPS)
            first = ~met & (above(here) >= -ROUNDING)
            after = np.where(first, here, after)
            met |= first
            before = np.where(met, before, here)
        for _ in range(HALVINGS):
            middle = 0.5 * (before + after)
            beyond = above(middle) >= 0.0
            before, after = np.where(beyond, before, middle), np.where(beyond, middle, after)
        return np.where(going & met, after, np.inf)


def _sloping(along_x: Array, along_y: Array) -> Array:
    """Return the rotations ``(..., 3, 3)`` of a surface whose height has these derivatives."""
    along_x, along_y = np.broadcast_arrays(along_x, along_y)
    zero, one = np.zeros_like(along_x), np.ones_like(along_x)
    across = np.stack([one, zero, along_x], axis=-1)
    out = np.stack([-along_x, -along_y, one], axis=-1)
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    out /= np.linalg.norm(out, axis=-1, keepdims=True)
    return np.stack([across, np.cross(out, across), out], axis=-1)
