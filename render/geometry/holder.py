"""The wall that holds the fibers around the pad, and whether neighbors would meet in it.

Seen from above: x across, y from base to tip (mm). All ends are at one height and all fibers have
one tilt, so fibers that cross in this view would have to pass through each other. The flat pad is
the tightest state: bending spreads the fibers of a side.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from render.arrays import Array
from render.geometry.layout import flat_fiber_poses
from render.scene import HOLDER_THICKNESS, Scene

WEB = 0.3
"""What a drill or a printer must leave of the wall between two fibers, mm."""
LEAST_SINE = 0.02
"""Of the angle between fiber and edge; flatter fibers are followed as far as this one."""


@dataclass(frozen=True, eq=False)
class FiberHolder:
    """A wall of even thickness whose inner face goes through the fiber ends of every edge.

    Fibers that stand upright on their edge always fit, however close they are.

    Arguments:
        position, along, inward: ``(fiber, 2)`` ends (mm) and unit vectors of `FiberPoses`.
        thickness: mm, of the wall.
        diameter: mm, of a fiber.
        least: ``(fiber - 1,)`` mm, least distance between the axes of fiber i and fiber i + 1.
    """

    position: Array
    along: Array
    inward: Array
    thickness: float
    diameter: float
    least: Array

    @classmethod
    def of(cls, scene: Scene) -> FiberHolder:
        """Return the holder of a scene."""
        poses, limits = flat_fiber_poses(scene), scene.constraints
        thickness = HOLDER_THICKNESS if limits is None else limits.holder_thickness
        flat = (poses.position[:, :2], poses.along[:, :2], poses.inward[:, :2])
        free = cls(*flat, thickness, scene.fibers.diameter, np.zeros(scene.fibers.count - 1))
        upright = free.distances(np.full(scene.fibers.count, np.pi / 2))
        least = np.minimum(scene.fibers.diameter + WEB, upright - 1e-9)
        return cls(*flat, thickness, scene.fibers.diameter, least)

    def outer_ends(self, phi: Array) -> Array:
        """Return where the axes leave the wall, ``(..., fiber, 2)`` mm, for ``phi`` in rad."""
        cos, sin = np.cos(phi)[..., None], np.sin(phi)[..., None]
        length = self.thickness / np.maximum(sin, LEAST_SINE)
        return np.asarray(self.position - length * (cos * self.along + sin * self.inward))

    def distances(self, phi: Array) -> Array:
        """Return the distances of neighboring axes inside the wall, ``(..., fiber - 1)`` mm.

        The neighbor of a fiber is the next one around the pad, also at a corner; who does not
        meet a neighbor meets nobody.
        """
        start = np.broadcast_to(self.position, (*phi.shape, 2))
        end = self.outer_ends(phi)
        first, second = (start[..., :-1, :], end[..., :-1, :]), (start[..., 1:, :], end[..., 1:, :])
        ends = [_to_segment(point, second) for point in first]
        ends += [_to_segment(point, first) for point in second]
        return np.where(_cross(first, second), 0.0, np.minimum.reduce(ends))

    def slack(self, phi: Array) -> Array:
        """Return by how much the distances exceed the least ones, ``(..., fiber - 1)`` mm."""
        return self.distances(phi) - self.least

    def problems(self, phi: Array) -> Iterator[str]:
        """Yield which fibers of directions ``phi`` ``(fiber,)`` meet, one sentence each."""
        distance = self.distances(phi)
        for i in np.flatnonzero(distance < self.least):
            yield (
                f"fibers {i} and {i + 1} at {np.degrees(phi[i]):.0f} and "
                f"{np.degrees(phi[i + 1]):.0f} deg leave {distance[i] - self.diameter:.2f} mm "
                f"between them in a holder of {self.thickness:g} mm, needed: at least "
                f"{self.least[i] - self.diameter:.2f} mm"
            )

    @property
    def sentence(self) -> str:
        """What the holder asks of designs."""
        return (
            f"neighboring fibers leave {WEB:g} mm between them in a holder "
            f"{self.thickness:g} mm thick"
        )


Segment = tuple[Array, Array]
"""Both ends, ``(..., 2)`` each."""


def _to_segment(point: Array, segment: Segment) -> Array:
    """Return the distance of points ``(..., 2)`` from segments."""
    start, way = segment[0], segment[1] - segment[0]
    part = ((point - start) * way).sum(axis=-1) / (way**2).sum(axis=-1)
    nearest = start + np.clip(part, 0.0, 1.0)[..., None] * way
    return np.asarray(np.linalg.norm(point - nearest, axis=-1))


def _cross(first: Segment, second: Segment) -> NDArray[np.bool_]:
    """Return whether segments cross."""

    def apart(segment: Segment, other: Segment) -> NDArray[np.bool_]:
        """Return whether the ends of ``other`` lie on different sides of the line."""
        way = segment[1] - segment[0]
        sides = [
            way[..., 0] * (end - segment[0])[..., 1] - way[..., 1] * (end - segment[0])[..., 0]
            for end in other
        ]
        return np.asarray(sides[0] * sides[1] < 0.0)

    return np.asarray(apart(first, second) & apart(second, first))
