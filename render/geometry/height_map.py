"""The skin around what is pressed in, as a map of depths over the pad.

A body alone is a rigid shape with sharp edges; skin touches its high parts and spans the rest. The
height map of a body is smoothed by a pyramid of Gaussians, each half as wide as the last, after
each of which the skin is put back where it touches (Si and Yuan 2022, "Taxim"; the parameters
published with it go from 0.9 to 0.03 mm). Taxim says where it touches by a share of the depth.
Here that is wherever the smoothed map would pass through the body, which needs no such number: no
skin is inside the body, what the Gaussians cannot reach touches as before, and a deeper body makes
a deeper map everywhere.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from render.arrays import Array
from render.errors import SceneError
from render.scene import Scene

SMOOTHING = 0.3
"""Standard deviation of the first Gaussian for bodies from a file, mm; assumed."""
HALVINGS = 5
"""How often the Gaussians are halved."""
EDGE_PART = 0.02
"""Part of the largest depth by which smoothing may move the skin at the pad's edges, where it is
held."""
STEP = 0.05
"""Distance of the map's points, mm, unless that makes more of them than MAX_POINTS on a side."""
MAX_POINTS = 1200
FLAT_PART = 1e-3
"""Skin that is pressed in by less than this part of the deepest counts as untouched."""


@dataclass(frozen=True, eq=False)
class HeightMap:
    """How deep the skin is pressed in, straight down from the untouched one; it follows the bend.

    Arguments:
        depth: ``(row, column)`` mm, from the base and from -x, the first and last on the edges.
        width, length: of the pad, mm.
        about: what was pressed in, for people; "" where they named it.
    """

    depth: Array
    width: float
    length: float
    about: str = ""

    @property
    def step(self) -> tuple[float, float]:
        """Distance of columns and of rows, mm."""
        rows, columns = self.depth.shape
        return self.width / (columns - 1), self.length / (rows - 1)

    @property
    def deepest(self) -> float:
        """Largest depth, mm."""
        return float(self.depth.max())

    @cached_property
    def bounds(self) -> tuple[float, float, float, float]:
        """Low x and y, high x and y of the pressed part, mm."""
        pressed = self.depth > FLAT_PART * self.deepest
        (dx, dy), found = self.step, []
        for axis, step, side in ((0, dx, self.width), (1, dy, self.length)):
            at = np.nonzero(pressed.any(axis=axis))[0]
            first, last = (at[0], at[-1]) if len(at) else (0, 0)
            found.append((step * (first - 1) - 0.5 * side, step * (last + 1) - 0.5 * side))
        (low_x, high_x), (low_y, high_y) = found
        return low_x, low_y, high_x, high_y

    @property
    def size(self) -> float:
        """The larger one of the deepest and of half the pressed part's longer side, mm."""
        low_x, low_y, high_x, high_y = self.bounds
        return max(self.deepest, 0.5 * (high_x - low_x), 0.5 * (high_y - low_y))

    def at(self, x: Array, y: Array) -> Array:
        """Return the depth at flat places, mm, bilinear between the map's points."""
        rows, columns = self.depth.shape
        across = np.clip((x / self.width + 0.5) * (columns - 1), 0, columns - 1)
        along = np.clip((y / self.length + 0.5) * (rows - 1), 0, rows - 1)
        i, j = (
            np.minimum(at.astype(np.int64), count - 2)
            for at, count in ((across, columns), (along, rows))
        )
        u, v = across - i, along - j
        low = (1 - u) * self.depth[j, i] + u * self.depth[j, i + 1]
        high = (1 - u) * self.depth[j + 1, i] + u * self.depth[j + 1, i + 1]
        return np.asarray((1 - v) * low + v * high)

    def smoothed(self, length: float) -> HeightMap:
        """Return the skin over this body: see the head of this file; ``length`` in mm, 0 is none.

        The skin is held at the pad's edges.

        Raises:
            SceneError: smoothed skin would move there.
        """
        if length <= 0.0:
            return self
        # A robot's check comes by here, and has no scipy.
        from scipy.ndimage import gaussian_filter

        skin, (dx, dy) = self.depth, self.step
        for halving in range(HALVINGS + 1):
            sigma = length / 2**halving
            spread = gaussian_filter(skin, (sigma / dy, sigma / dx), mode="constant")
            skin = np.clip(spread, self.depth, self.deepest)  # no deeper, by rounding either
        held = np.ones(skin.shape, dtype=bool)
        held[1:-1, 1:-1] = False
        moved = (skin - self.depth)[held].max()
        if moved > EDGE_PART * self.deepest:
            raise SceneError(
                f"smooth = {length:g} mm moves the skin at the pad's edge by {moved:.2g} mm, "
                f"allowed: {EDGE_PART:.0%} of the depth of {self.deepest:.3g} mm; take a shorter "
                "length, or a smaller body",
                field="smooth",
            )
        return replace(self, depth=np.where(held, self.depth, skin))


def map_lines(scene: Scene) -> tuple[Array, Array]:
    """Return where the columns ``x`` and rows ``y`` of a height map of the pad are, mm."""
    x, y = (
        np.linspace(-0.5 * side, 0.5 * side, min(int(np.ceil(side / STEP)) + 1, MAX_POINTS))
        for side in (scene.pad.width, scene.pad.length)
    )
    return x, y
