"""Fibers as light sources: a disk with a Gaussian radiance profile, in many directions at once.

The end face is a disk perpendicular to the beam; the profile is that of
``render.optics.fiber_profile`` at unit power.

One light path serves every direction node: it is drawn from the equal mixture of all nodes'
emission, and weighted per node by radiance over mixture density in ray space (projected area x
solid angle). A line that misses a node's disk weighs zero for that node.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from render.arrays import Array
from render.geometry import fiber_poses
from render.optics.fiber_profile import (
    density,
    falloff,
    peak_radiance,
    sample_direction,
    truncated_mass,
)
from render.scene import Scene


class FiberLight:
    """All fibers of a scene at one bend, each with ``J`` direction nodes ``(fiber, J)`` rad."""

    def __init__(self, scene: Scene, phi: Array, bend: float) -> None:
        """Upload poses; ``phi`` is ``(fiber, node)`` in radians."""
        poses = fiber_poses(scene, bend)
        # (node, fiber, 3) -> (fiber, node, 3)
        beams = poses.directions(phi.T, scene.fibers.tilt).transpose(1, 0, 2)
        self.nodes = phi.shape[1]
        self.radius = scene.fibers.diameter / 2
        self.sigma_v = scene.fibers.sigma_v
        self.area = np.pi * self.radius**2
        self.peak = peak_radiance(self.sigma_v, self.area)
        self.norm = truncated_mass(self.sigma_v)
        self.center = mi.TensorXf(poses.position.astype(np.float32)).array
        self.beam = mi.TensorXf(beams.astype(np.float32)).array
        self.constants = mi.Float([self.radius, self.sigma_v, self.peak, self.norm])
        dr.make_opaque(self.center, self.beam, self.constants)

    def _center(self, fiber: mi.UInt32) -> mi.Point3f:
        return dr.gather(mi.Point3f, self.center, fiber)

    def _beam(self, fiber: mi.UInt32, node: mi.UInt32) -> mi.Vector3f:
        return dr.gather(mi.Vector3f, self.beam, fiber * self.nodes + node)

    def sample(
        self, fiber: mi.UInt32, pick: mi.Float, direction: tuple[mi.Float, mi.Float],
        square: mi.Point2f,
    ) -> tuple[mi.Point3f, mi.Vector3f]:  # fmt: skip
        """Return origin and direction of rays drawn from the mixture over nodes."""
        sigma_v, norm = self._constant(1), self._constant(3)
        node = dr.minimum(mi.UInt32(pick * self.nodes), self.nodes - 1)
        frame = mi.Frame3f(self._beam(fiber, node))
        local = sample_direction(direction[0], direction[1], sigma_v, norm)
        disk = self._constant(0) * mi.warp.square_to_uniform_disk_concentric(square)
        origin = self._center(fiber) + frame.to_world(mi.Vector3f(disk.x, disk.y, 0.0))
        return mi.Point3f(origin), frame.to_world(local)

    def weights(self, fiber: mi.UInt32, o: mi.Point3f, d: mi.Vector3f) -> list[mi.Float]:
        """Return, per node, radiance over mixture density for rays ``(o, d)``."""
        radius, sigma_v, peak, norm = (self._constant(i) for i in range(4))
        radiance, mixture = [], mi.Float(0.0)
        offset = o - self._center(fiber)
        for j in range(self.nodes):
            beam = self._beam(fiber, mi.UInt32(j))
            cos = dr.dot(beam, d)
            # Where the line meets the node's disk, seen from the disk's center.
            hit = offset - d * (dr.dot(offset, beam) / cos)
            # The node that drew the ray must count as hit in spite of rounding.
            inside = (cos > 1e-4) & (dr.squared_norm(hit) <= dr.square(radius * 1.0001))
            theta = dr.unit_angle(mi.Vector3f(beam), mi.Vector3f(d))
            radiance.append(dr.select(inside, peak * falloff(theta, sigma_v), 0.0))
            mixture += dr.select(inside, density(theta, sigma_v, norm) / cos, 0.0)
        mixture = mixture / (self.nodes * dr.pi * dr.square(radius))
        scale = dr.select(mixture > 0, dr.rcp(mixture), 0.0)
        return [value * scale for value in radiance]

    def _constant(self, index: int) -> mi.Float:
        return dr.gather(mi.Float, self.constants, mi.UInt32(index))
