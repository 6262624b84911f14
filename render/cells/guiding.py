"""Guiding camera subpaths from a facet towards the glow of one fiber.

Most light that reaches a facet left the diffuser within a few millimeters of its fiber, on a
straight line or mirrored in the lower face by total internal reflection. A cosine-distributed
direction rarely finds that spot, so half of the directions at the facet are aimed at it: at a
point of the diffuser's inner face, or of its mirror image below the pad. The mixture density
enters the MIS weights like any other, so a poor aim on a strongly bent pad costs time, not truth.

On bent pads that are clear, or have a thin layer, directions are drawn from what photons say
instead (``render.cells.arriving_light``).
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from render.cells.arriving_light import ArrivingLight
from render.cells.lamp_aim import LampAim
from render.geometry import fiber_poses, flat_fiber_poses
from render.paths.vertex import Vertex
from render.scene import Scene

GUIDED_FRACTION, AIMED_GUIDED_FRACTION = 0.5, 0.8
"""Probability of guided directions, without and with an aim; the rest follow the coating's BSDF."""
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


@dataclass
class FacetGuiding:
    """The glow of each lane's fiber as ``render.paths.walk.GuidingDistribution`` of the facet.

    With an ``aim``, ``aimed`` of the guided directions go to the lamp itself, the others to the
    ``glow``, or to where photons arrive from.
    """

    glow: FiberGlow | ArrivingLight
    fiber: mi.UInt32
    aim: LampAim | None = None
    aimed: mi.Float | None = None

    @property
    def fraction(self) -> float:
        """Probability of guided directions."""
        return GUIDED_FRACTION if self.aim is None else AIMED_GUIDED_FRACTION

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
        """Return a direction towards the fiber's glow, or the lamp, for a ``number`` selected."""
        part = number / self.fraction
        if self.aim is None or self.aimed is None:
            return self.glow.sample(self.fiber, v, part, x, y)
        aimed = self.aim.sample(self.fiber, v.p, part / self.aimed, x, y)
        rest = dr.maximum(part - self.aimed, 0.0) / (1.0 - self.aimed)
        glow = self.glow.sample(self.fiber, v, rest, x, y)
        return dr.select(part < self.aimed, aimed, glow)

    def mixture_pdf(self, v: Vertex, direction: mi.Vector3f, pdf: mi.Float) -> mi.Float:
        """Return the density of the mixture of BSDF sampling (``pdf``) and guiding."""
        guided = self.glow.density(self.fiber, v, direction)
        if self.aim is not None and self.aimed is not None:
            aimed = self.aim.density(self.fiber, v.p, direction)
            guided = (1.0 - self.aimed) * guided + self.aimed * aimed
        return (1.0 - self.fraction) * pdf + self.fraction * guided
