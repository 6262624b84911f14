"""Lamps as light sources: disks with a radiance profile, in many directions at once.

The end face is a disk perpendicular to the beam; ``render.optics.lamp_profiles`` has its profile at
unit power.

One light path serves every direction node: it is drawn from the equal mixture of all nodes'
emission, and weighted per node by radiance over mixture density in ray space (projected area x
solid angle). A line that misses a node's disk weighs zero for that node.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from render.arrays import Array
from render.geometry import fiber_poses
from render.optics.lamp_profiles import LampProfiles
from render.optics.pad_scene import scattering_medium
from render.scene import Scene

COSINE_MIN = 1e-4
"""Least cosine between a beam and a line that counts as crossing its end face."""


@dataclass
class LampRay:
    """What one line carries (a Dr.Jit PyTree).

    ``radiance`` per direction node in 1/(mm^2 sr); ``emitted`` the density with which ``sample``
    draws the line, per projected area and solid angle; ``joined`` that of directions to points of
    ``sample_position``, per solid angle at the point that the line was asked for.
    """

    radiance: list[mi.Float]
    emitted: mi.Float
    joined: mi.Float


class FiberLight:
    """All fibers of a scene at one bend, each with ``J`` direction nodes ``(fiber, J)`` rad."""

    def __init__(self, scene: Scene, phi: Array, bend: float) -> None:
        """Upload poses; ``phi`` is ``(fiber, node)`` in radians."""
        poses = fiber_poses(scene, bend)
        # (node, fiber, 3) -> (fiber, node, 3)
        beams = poses.directions(phi.T).transpose(1, 0, 2)
        self.nodes = phi.shape[1]
        areas = np.pi * poses.radius**2
        self.profiles = LampProfiles(
            [lamp.profile for lamp in scene.placed_lamps()], areas.tolist()
        )
        self.radius = mi.Float(poses.radius.astype(np.float32))
        # Lamps that turn stay clear of the silicone all around; others may be nearer than they are
        # wide, so that a segment inside passes by their center closely and never meets them.
        self.still = None if poses.turns.all() else mi.Bool(~poses.turns)
        # Cast into the silicone: segments begin and end around them.
        self.cast_in = mi.Bool(poses.inside) if poses.inside.any() else None
        # A rim that neither scatters nor absorbs has no medium.
        in_layer = poses.inside & (poses.layer > 0.0)
        scatters = scattering_medium(scene) is not None
        self.in_layer = mi.Bool(in_layer) if scatters and in_layer.any() else None
        self.center = mi.TensorXf(poses.position.astype(np.float32)).array
        self.beam = mi.TensorXf(beams.astype(np.float32)).array
        dr.make_opaque(self.center, self.beam, self.radius, self.still, self.cast_in, self.in_layer)

    def center_of(self, fiber: mi.UInt32) -> mi.Point3f:
        """Return the middle of the end of ``fiber``, mm."""
        return dr.gather(mi.Point3f, self.center, fiber)

    def beam_of(self, fiber: mi.UInt32, node: mi.UInt32) -> mi.Vector3f:
        """Return the unit beam of ``fiber`` at a direction node."""
        return dr.gather(mi.Vector3f, self.beam, fiber * self.nodes + node)

    def sample(
        self, fiber: mi.UInt32, pick: mi.Float, direction: tuple[mi.Float, mi.Float],
        square: mi.Point2f,
    ) -> tuple[mi.Point3f, mi.Vector3f]:  # fmt: skip
        """Return origin and direction of rays drawn from the mixture over nodes."""
        origin, frame = self.sample_position(fiber, pick, square)
        local = self.profiles.sample(fiber, direction[0], direction[1])
        return origin, frame.to_world(local)

    def ray(
        self, fiber: mi.UInt32, p: mi.Point3f, d: mi.Vector3f,
        spread: Callable[[mi.Float], mi.Float] = dr.square, edge: float = 1.0001,
        behind: float | None = None,
    ) -> LampRay:  # fmt: skip
        """Return what the lines through ``p`` along ``d``, the way of the light, carry.

        Over a distance from the end to ``p`` in mm the line moves on the end, in mm^2 per solid
        angle where it was asked for, by its ``spread``: the squared distance if nothing bends it.
        The end is ``edge`` times as wide, so that a line to its edge counts in spite of rounding.
        It may have begun ``behind`` ``p`` by so many mm; without it anywhere, but is not joined
        then.
        """
        radius = dr.gather(mi.Float, self.radius, fiber)
        radiance, mixture, joined = [], mi.Float(0.0), mi.Float(0.0)
        offset = p - self.center_of(fiber)
        for j in range(self.nodes):
            beam = self.beam_of(fiber, mi.UInt32(j))
            cos = dr.dot(beam, d)
            # Where the line meets the node's disk, seen from the disk's center.
            distance = dr.dot(offset, beam) / cos
            hit = offset - d * distance
            crossed = dr.squared_norm(hit) <= dr.square(radius * edge)
            if behind is not None:
                crossed &= distance > -behind
            inside = (cos > COSINE_MIN) & crossed
            # Points are drawn on end faces that turn their back as well, and lines to those may
            # carry the light of other nodes.
            crossed &= dr.abs(cos) > COSINE_MIN
            theta = dr.unit_angle(mi.Vector3f(beam), mi.Vector3f(d))
            radiance.append(dr.select(inside, self.profiles.radiance(fiber, theta), 0.0))
            mixture += dr.select(inside, self.profiles.density(fiber, theta) / cos, 0.0)
            facing = spread(distance) / dr.abs(cos)
            before = mi.Bool(True) if behind is not None else distance > 0
            joined += dr.select(crossed & before, facing, 0.0)
        share = 1.0 / (self.nodes * dr.pi * dr.square(radius))
        return LampRay(radiance, mixture * share, joined * share)

    def medium(self, scene: mi.Scene, fiber: mi.UInt32) -> mi.MediumPtr:
        """Return what is around the ends of lamps of a pad: a medium in the diffuser alone."""
        clear = dr.zeros(mi.MediumPtr)
        if self.in_layer is None:
            return clear
        inner = [shape.interior_medium() for shape in scene.shapes()]
        (medium,) = {medium.id(): medium for medium in inner if medium is not None}.values()
        return dr.select(dr.gather(mi.Bool, self.in_layer, fiber), mi.MediumPtr(medium), clear)

    def weights(self, fiber: mi.UInt32, o: mi.Point3f, d: mi.Vector3f) -> list[mi.Float]:
        """Return, per node, radiance over mixture density for rays ``(o, d)``."""
        ray = self.ray(fiber, o, d)
        scale = dr.select(ray.emitted > 0, dr.rcp(ray.emitted), 0.0)
        return [value * scale for value in ray.radiance]

    def sample_position(
        self, fiber: mi.UInt32, pick: mi.Float, square: mi.Point2f
    ) -> tuple[mi.Point3f, mi.Frame3f]:
        """Return points on the end face, uniform in its area, and the frame about its beam.

        ``pick`` draws the direction node that the face belongs to.
        """
        node = dr.minimum(mi.UInt32(pick * self.nodes), self.nodes - 1)
        frame = mi.Frame3f(self.beam_of(fiber, node))
        radius = dr.gather(mi.Float, self.radius, fiber)
        disk = radius * mi.warp.square_to_uniform_disk_concentric(square)
        point = self.center_of(fiber) + frame.to_world(mi.Vector3f(disk.x, disk.y, 0.0))
        return mi.Point3f(point), frame

    def _to_plane(self, fiber: mi.UInt32, offset: mi.Vector3f, d: mi.Vector3f) -> mi.Float:
        beam = self.beam_of(fiber, mi.UInt32(0))
        return dr.dot(offset, beam) / dr.dot(d, beam)

    def passed(self, fiber: mi.UInt32, o: mi.Point3f, d: mi.Vector3f, end: mi.Float) -> mi.Bool:
        """Return whether rays ``(o, d)`` of length ``end`` (mm) pass through a fiber's end face.

        Of a fiber that turns: through the sphere of all its end faces.
        """
        offset = self.center_of(fiber) - o
        ahead = dr.dot(offset, d)
        radius = dr.gather(mi.Float, self.radius, fiber)
        miss = dr.squared_norm(offset - ahead * d)
        within = dr.square(radius * 1.0001)
        near = (miss <= within) & (ahead > -radius) & (ahead < end)
        if self.cast_in is not None:
            near &= (ahead > 0) | ~dr.gather(mi.Bool, self.cast_in, fiber)
        if self.still is None:
            return near
        distance = self._to_plane(fiber, offset, d)
        through = (dr.squared_norm(offset - distance * d) <= within) & (distance > 0)
        still = dr.gather(mi.Bool, self.still, fiber)
        return dr.select(still, through & (distance < end), near)
