"""Fibers as light sources: a disk with a Gaussian radiance profile, in many directions at once.

Thesis 3.3.1: ``L(omega) = L_max exp(-((omega - omega_d) / (2 sigma_v))^2) / (2 pi sigma_v)``, where
the difference is the angle between the directions. The end face is a disk perpendicular to the
beam; ``L_max`` is chosen so that the disk emits unit power.

One light path serves every direction node: it is drawn from the equal mixture of all nodes'
emission, and weighted per node by radiance over mixture density in ray space (projected area x
solid angle). A line that misses a node's disk weighs zero for that node.
"""

from __future__ import annotations

import numpy as np
from scipy.integrate import quad
from typing import Any

import drjit as dr
import mitsuba as mi

from render.bending import Array
from render.layout import fiber_poses
from render.scene import Scene


def peak_radiance(sigma_v: float, diameter: float) -> float:
    """Return the on-axis radiance in 1/(mm^2 sr) of a fiber end that emits unit power."""
    area = np.pi * (diameter / 2) ** 2
    flux, _ = quad(
        lambda t: np.exp(-((t / (2 * sigma_v)) ** 2)) * np.cos(t) * np.sin(t),
        0.0, np.pi / 2, points=[min(2 * sigma_v, 1.5)], limit=200,
    )  # fmt: skip
    return float(1.0 / (2 * np.pi * area * flux))


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
        self.peak = peak_radiance(self.sigma_v, scene.fibers.diameter)
        # Rayleigh density in theta, cut at pi/2: what the sampled cone does not reach emits nothing.
        self.norm = -np.expm1(-((np.pi / 2) ** 2) / (4 * self.sigma_v**2))
        self.centre = mi.TensorXf(poses.position.astype(np.float32)).array
        self.beam = mi.TensorXf(beams.astype(np.float32)).array
        self.constants = mi.Float([self.radius, self.sigma_v, self.peak, self.norm])
        dr.make_opaque(self.centre, self.beam, self.constants)

    def _centre(self, fiber: Any) -> Any:
        return dr.gather(mi.Point3f, self.centre, fiber)

    def _beam(self, fiber: Any, node: Any) -> Any:
        return dr.gather(mi.Vector3f, self.beam, fiber * self.nodes + node)

    def sample(
        self, fiber: Any, pick: Any, direction: tuple[Any, Any], square: Any
    ) -> tuple[Any, Any]:
        """Return origin and direction of rays drawn from the mixture over nodes."""
        sigma_v, norm = self._constant(1), self._constant(3)
        node = dr.minimum(mi.UInt32(pick * self.nodes), self.nodes - 1)
        frame = mi.Frame3f(self._beam(fiber, node))
        theta = 2 * sigma_v * dr.sqrt(-dr.log(dr.maximum(1.0 - direction[0] * norm, 1e-38)))
        sin, cos = dr.sincos(theta)
        s, c = dr.sincos(2 * dr.pi * direction[1])
        disk = self._constant(0) * mi.warp.square_to_uniform_disk_concentric(square)
        origin = self._centre(fiber) + frame.to_world(mi.Vector3f(disk.x, disk.y, 0.0))
        return mi.Point3f(origin), frame.to_world(mi.Vector3f(sin * c, sin * s, cos))

    def weights(self, fiber: Any, o: Any, d: Any) -> list[Any]:
        """Return, per node, radiance over mixture density for rays ``(o, d)``."""
        radius, sigma_v, peak, norm = (self._constant(i) for i in range(4))
        radiance, density = [], mi.Float(0.0)
        offset = o - self._centre(fiber)
        for j in range(self.nodes):
            beam = self._beam(fiber, mi.UInt32(j))
            cos = dr.dot(beam, d)
            # Where the line meets the node's disk, seen from the disk's centre.
            hit = offset - d * (dr.dot(offset, beam) / cos)
            # The node that drew the ray must count as hit in spite of rounding.
            inside = (cos > 1e-4) & (dr.squared_norm(hit) <= dr.square(radius * 1.0001))
            theta = dr.safe_acos(cos)
            gauss = dr.exp(-dr.square(theta / (2 * sigma_v)))
            sin_over_theta = dr.select(theta > 1e-3, dr.sin(theta) / theta, 1.0)
            solid = gauss / (4 * dr.pi * dr.square(sigma_v) * norm * sin_over_theta)
            radiance.append(dr.select(inside, peak * gauss, 0.0))
            density += dr.select(inside, solid / cos, 0.0)
        density = density / (self.nodes * dr.pi * dr.square(radius))
        scale = dr.select(density > 0, dr.rcp(density), 0.0)
        return [value * scale for value in radiance]

    def _constant(self, index: int) -> Any:
        return dr.gather(mi.Float, self.constants, mi.UInt32(index))
