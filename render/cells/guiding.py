"""Guiding camera subpaths from a facet towards the glow of one fiber.

Most light that reaches a facet left the diffuser within a few millimeters of its fiber, on a
straight line or mirrored in the lower face by total internal reflection. A cosine-distributed
direction rarely finds that spot, so half of the directions at the facet are aimed at it: at a
point of the diffuser's inner face, or of its mirror image below the pad. The mixture density
enters the MIS weights like any other, so a poor aim on a strongly bent pad costs time, not truth.

Where lamps are seen, through a thin layer or none, directions are drawn from what photons say
instead (``render.cells.arriving_light``), or besides.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import drjit as dr
import mitsuba as mi
import numpy as np

from render.geometry import fiber_poses, flat_fiber_poses
from render.paths.vertex import Vertex
from render.scene import Scene

GUIDED_FRACTION, SEEN_GUIDED_FRACTION = 0.5, 0.8
"""Probability of guided directions, of hidden lamps and of seen ones; others follow the BSDF."""
LOGISTIC_SCALE = 1.0
"""Scale (mm) of the logistic distribution along the edge; its standard deviation is 1.8 mm."""


class FiberGlow:
    """Points where the light of each lamp enters the clear pad, at one bend."""

    def __init__(self, scene: Scene, bend: float) -> None:
        """Upload the frames; ``bend`` in radians."""
        poses = fiber_poses(scene, bend)
        height = flat_fiber_poses(scene).foot[:, 2]
        foot = poses.foot + poses.layer[:, None] * poses.face_inward
        # Measured from the camera-side face, so that [-thickness, thickness] is wall and mirror.
        foot -= (height + scene.box.depth)[:, None] * poses.up
        self.thickness = mi.Float(scene.pad.thickness + scene.box.depth)
        frames = np.stack([foot, poses.face_along, poses.face_inward, poses.face_up], axis=1)
        self.frames = mi.Float(frames.astype(np.float32).ravel())
        dr.make_opaque(self.frames, self.thickness)

    def _frame(self, fiber: mi.UInt32) -> tuple[mi.Point3f, mi.Vector3f, mi.Vector3f, mi.Vector3f]:
        parts = [dr.gather(mi.Vector3f, self.frames, 4 * fiber + i) for i in range(4)]
        return mi.Point3f(parts[0]), parts[1], parts[2], parts[3]

    def sample(
        self, fiber: mi.UInt32, v: Vertex, _pick: mi.Float, x: mi.Float, y: mi.Float
    ) -> mi.Vector3f:
        """Return directions from ``v`` towards the glow of ``fiber``; ``pick`` is not needed."""
        foot, along, _, up = self._frame(fiber)
        x = dr.clip(x, 1e-6, 1.0 - 1e-6)
        t = LOGISTIC_SCALE * dr.log(x / (1.0 - x))
        aim = foot + t * along + (2.0 * y - 1.0) * self.thickness * up
        return dr.normalize(aim - v.p)

    def density(self, fiber: mi.UInt32, v: Vertex, direction: mi.Vector3f) -> mi.Float:
        """Return the density per solid angle with which ``sample`` finds ``direction``."""
        foot, along, inward, up = self._frame(fiber)
        cosine = -dr.dot(direction, inward)
        distance = dr.dot(v.p - foot, inward) / cosine
        offset = v.p + distance * direction - foot
        z = dr.dot(offset, up)
        e = dr.exp(-dr.abs(dr.dot(offset, along)) / LOGISTIC_SCALE)
        logistic = e / (LOGISTIC_SCALE * dr.square(1.0 + e))
        area = logistic / (2.0 * self.thickness)
        hit = (cosine > 1e-4) & (distance > 0) & (dr.abs(z) <= self.thickness)
        return dr.select(hit, area * dr.square(distance) / cosine, 0.0)


class Directions(Protocol):
    """Directions in which a lamp's light may come to a vertex of the coating."""

    def sample(
        self, fiber: mi.UInt32, v: Vertex, pick: mi.Float, x: mi.Float, y: mi.Float
    ) -> mi.Vector3f:
        """Return directions from ``v``, for three uniform numbers."""

    def density(self, fiber: mi.UInt32, v: Vertex, direction: mi.Vector3f) -> mi.Float:
        """Return the density per solid angle with which ``sample`` finds ``direction``."""


@dataclass
class FacetGuiding:
    """Directions to each lane's fiber as ``render.paths.walk.GuidingDistribution`` of the facet.

    ``fraction`` is the probability of guided directions, ``shares`` how they are divided among
    ``ways``.
    """

    ways: list[Directions]
    shares: list[mi.Float]
    fraction: float
    fiber: mi.UInt32

    def applies(self, v: Vertex) -> mi.Bool:
        """Return whether ``v`` is on the coating, and not the end of the subpath."""
        return v.diffuse & ~v.terminal

    def selected(self, v: Vertex, number: mi.Float) -> mi.Bool:
        """Return whether this number picks the guided direction."""
        return self.applies(v) & (number < self.fraction)

    def unselected(self, v: Vertex, number: mi.Float) -> mi.Float:
        """Return a number in [0, 1) again, for the BSDF, of one that was not ``selected``."""
        rest = dr.maximum(number - self.fraction, 0.0) / (1.0 - self.fraction)
        return dr.select(self.applies(v), rest, number)

    def sample(self, v: Vertex, number: mi.Float, x: mi.Float, y: mi.Float) -> mi.Vector3f:
        """Return a direction from where the fiber's light comes, for a ``number`` selected."""
        pick = number / self.fraction
        direction = self.ways[0].sample(self.fiber, v, pick / self.shares[0], x, y)
        begin = self.shares[0]
        for way, share in zip(self.ways[1:], self.shares[1:], strict=True):
            within = dr.maximum(pick - begin, 0.0) / share
            direction = dr.select(pick >= begin, way.sample(self.fiber, v, within, x, y), direction)
            begin = begin + share
        return direction

    def mixture_pdf(self, v: Vertex, direction: mi.Vector3f, pdf: mi.Float) -> mi.Float:
        """Return the density of the mixture of BSDF sampling (``pdf``) and guiding."""
        total = (1.0 - self.fraction) * pdf
        for way, share in zip(self.ways, self.shares, strict=True):
            total += self.fraction * share * way.density(self.fiber, v, direction)
        return total
