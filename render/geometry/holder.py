"""The wall that holds the fibers around the pad, and what holes for them leave of it.

Seen from above, walls stand along the left, tip and right edge (and along the base, where a row is)
and meet in miters at the corners. Their inner faces go through the fiber ends. Fibers of one row,
and of rows at nearly one height, that cross in this view would have to pass through each other;
lamps that do not turn need no hole. The flat pad is the
tightest state: bending spreads the fibers of a side.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from render.arrays import Array
from render.geometry.lamp_poses import flat_fiber_poses
from render.scene import EDGES, HOLDER_THICKNESS, Edge, Scene

PLAY = 0.1
"""mm by which a hole is wider than its fiber."""
LEAST_WALL = 0.2
"""mm that a drill or a printer must leave between two holes."""
LEAST_SINE = 0.02
"""Of the angle between fiber and edge; flatter fibers are treated like this one."""
ALONG: dict[Edge, Array] = {
    "left": np.array([0.0, 1.0]),
    "tip": np.array([1.0, 0.0]),
    "right": np.array([0.0, -1.0]),
    "base": np.array([-1.0, 0.0]),
}
"""Which way fibers are numbered on an edge: around the pad, from the left edge's base."""
BESIDE: dict[Edge, tuple[Edge, Edge]] = {
    "left": ("base", "tip"),
    "tip": ("left", "right"),
    "right": ("tip", "base"),
    "base": ("right", "left"),
}
"""The edges where that way begins and where it ends."""


@dataclass(frozen=True, eq=False)
class FiberHolder:
    """Walls of even thickness with a hole for every fiber.

    A border of the wall lies between two neighbors of one edge, and between a corner and the fiber
    next to it. What is left there is measured along the edge, at the face where it is thinnest.
    Upright fibers always fit, however close they are.

    Arguments:
        place: ``(fiber,)`` mm, the ends in the direction of `ALONG`.
        turns: ``(fiber,)`` 1 where phi = 0 is that direction, -1 where it is the other.
        first, last: ``(border,)`` the fibers before and after it, -1 for a corner.
        corner: ``(border,)`` mm, where the inner faces meet, in the direction of `ALONG` of the
            edge of the border's fiber; 0 between fibers.
        thickness: mm, of the walls.
        hole: ``(fiber,)`` mm, diameter of the holes.
        least: ``(border,)`` mm that must be left.
    """

    place: Array
    turns: Array
    first: NDArray[np.int64]
    last: NDArray[np.int64]
    corner: Array
    thickness: float
    hole: Array
    least: Array

    @classmethod
    def of(cls, scene: Scene) -> FiberHolder:
        """Return the holder of a scene."""
        limits, lamps, poses = scene.constraints, scene.placed_lamps(), flat_fiber_poses(scene)
        way = np.array([ALONG[lamp.edge] if lamp.edge else np.zeros(2) for lamp in lamps])
        place = (poses.position[:, :2] * way).sum(axis=1)
        hole = 2 * poses.radius + PLAY
        # What is cast into the silicone needs no hole.
        held = [i for i, lamp in enumerate(lamps) if lamp.edge and lamp.turns and not lamp.solid]
        base_wall = any(lamps[i].edge == "base" for i in held)
        borders, rims = [], dict(zip(EDGES, scene.box.rims, strict=True))
        for edge in ALONG:
            # Rows at different heights pass each other.
            own = sorted((i for i in held if lamps[i].edge == edge), key=lambda i: place[i])
            half = scene.pad.width if edge in ("tip", "base") else scene.pad.length
            for i in own:
                height, level = poses.position[:, 2], poses.position[i, 2]
                others = [j for j in own if abs(height[j] - level) < (hole[i] + hole[j]) / 2]
                first, last = (half / 2 + rims[beside] + poses.gap[i] for beside in BESIDE[edge])
                if i == others[0] and (edge != "left" or base_wall):
                    borders.append((-1, i, -first))
                later = others[others.index(i) + 1 :]
                if later:
                    borders.append((i, later[0], 0.0))
                elif edge != "right" or base_wall:
                    borders.append((i, -1, last))
        before, after, corner = np.array(borders, dtype=float).reshape(-1, 3).T
        holder = cls(
            place=place,
            turns=(poses.along[:, :2] * way).sum(axis=1),
            first=before.astype(np.int64),
            last=after.astype(np.int64),
            corner=corner,
            thickness=HOLDER_THICKNESS if limits is None else limits.holder_thickness,
            hole=hole,
            least=np.zeros(len(corner)),
        )
        upright = holder.walls(np.full(len(lamps), np.pi / 2))
        return replace(holder, least=np.minimum(LEAST_WALL, upright - 1e-9))

    def walls(self, phi: Array) -> Array:
        """Return what is left at every border, ``(..., border)`` mm, for ``phi`` ``(..., F)``."""
        sin = np.maximum(np.sin(phi), LEAST_SINE)
        half, shift = self.hole / 2 / sin, -self.turns * np.cos(phi) / sin
        walls = []
        for depth in (0.0, self.thickness):
            center = self.place + depth * shift
            # A miter moves out by as much as it is deep; index -1 picks some fiber, not used.
            begin = np.where(self.first < 0, self.corner - depth, (center + half)[..., self.first])
            end = np.where(self.last < 0, self.corner + depth, (center - half)[..., self.last])
            walls.append(end - begin)
        return np.asarray(np.minimum(*walls))

    def slack(self, phi: Array) -> Array:
        """Return by how much `walls` exceed the least ones, ``(..., border)`` mm."""
        return self.walls(phi) - self.least

    def crowded(self, phi: Array) -> NDArray[np.bool_]:
        """Return which fibers are beside a wall that is too thin, ``(..., fiber)``."""
        thin, beside = self.slack(phi) < 0.0, np.zeros(phi.shape, dtype=bool)
        for border in range(len(self.least)):
            for fiber in (self.first[border], self.last[border]):
                if fiber >= 0:
                    beside[..., fiber] |= thin[..., border]
        return beside

    def problems(self, phi: Array, lit: NDArray[np.bool_] | None = None) -> Iterator[str]:
        """Yield where holes for directions ``phi`` ``(F,)`` leave too little, one sentence each.

        Only fibers that are ``lit`` ``(F,)`` have holes; all unless given.
        """
        walls, degrees = self.walls(phi), np.degrees(phi)
        for border in np.flatnonzero(walls < self.least):
            fibers = [f for f in (self.first[border], self.last[border]) if f >= 0]
            if lit is not None and not lit[fibers].all():
                continue
            angles = " and ".join(f"{degrees[f]:.0f}" for f in fibers)
            who = (
                f"fibers {fibers[0]} and {fibers[1]} at {angles} deg meet"
                if len(fibers) == 2
                else f"fiber {fibers[0]} at {angles} deg meets the corner"
            )
            yield (
                f"{who} in a holder {self.thickness:g} mm thick: {walls[border]:.2f} mm of wall "
                f"are left, needed: at least {self.least[border]:.2f} mm"
            )

    @property
    def sentence(self) -> str:
        """What the holder asks of designs, where it holds any."""
        return f"fibers do not meet in the holder around the pad, {self.thickness:g} mm thick"
