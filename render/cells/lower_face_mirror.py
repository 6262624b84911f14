"""Bridging a facet and a light vertex over one glossy reflection in the lower face.

A third of a facet's light arrives by total internal reflection in the rough lower face. Joining
straight to a vertex on that face mostly misses its narrow lobe. The bridge instead mirrors the
light vertex in the face, draws a direction from the facet close to the mirror image, as wide as
the roughness makes the reflection, and lets it find the face. Its density is known for any
path, so it is one more strategy of the balance heuristic (Veach 1997, sec. 9.2), for the paths

    ... - y (volume or diffuse) - b (glossy) - facet - ...

On a bent pad the mirror is the plane that touches the face between both points: an approximation
of the aim only, never of the estimate.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from render.paths.connect import cast, optical_depth
from render.paths.reflection_lobe import AimLobe
from render.paths.vertex import Vertex, area_factor, extinction, scatter
from render.paths.walk import Aim
from render.scene import Scene

# Below this curvature (1/mm) times 1 mm the mirror is taken to be flat.
FLAT = 1e-4


class Bridge:
    """The lower face of one pad as a mirror."""

    def __init__(self, scene: Scene, bend: float) -> None:
        """Prepare the mirror at ``bend`` radians."""
        kappa = bend / scene.pad.length
        self.curved = kappa > FLAT
        radius = 1.0 / kappa if self.curved else 0.0
        slope = scene.pad.roughness / np.sqrt(2.0)
        self.constants = mi.Float(
            [scene.camera.y, scene.pad.thickness + radius, radius + scene.pad.thickness, slope]
        )
        dr.make_opaque(self.constants)

    def _constant(self, index: int) -> Any:
        return dr.gather(mi.Float, self.constants, mi.UInt32(index))

    def _mirror(self, a: Any, y: Any) -> tuple[Any, Any, Any, Any]:
        """Return mirror image of ``y``, the mirror's normal, and both heights above it."""
        if not self.curved:
            image = mi.Point3f(y.x, y.y, -y.z)
            return image, mi.Vector3f(0.0, 0.0, 1.0), dr.abs(a.z), dr.abs(y.z)
        centre_y, centre_z, outer = (self._constant(i) for i in range(3))
        angle_a = dr.atan2(a.y - centre_y, centre_z - a.z)
        angle_y = dr.atan2(y.y - centre_y, centre_z - y.z)
        radius_a: Any = dr.hypot(a.y - centre_y, centre_z - a.z)  # type: ignore[no-untyped-call]
        radius_y: Any = dr.hypot(y.y - centre_y, centre_z - y.z)  # type: ignore[no-untyped-call]
        height_a: Any = dr.abs(outer - radius_a)
        height_y: Any = dr.abs(outer - radius_y)
        share = height_a / dr.maximum(height_a + height_y, 1e-6)
        sin, cos = dr.sincos(angle_a + share * (angle_y - angle_a))
        normal = mi.Vector3f(0.0, -sin, cos)
        foot = mi.Point3f(0.0, centre_y + outer * sin, centre_z - outer * cos)
        return y - 2.0 * dr.dot(y - foot, normal) * normal, normal, height_a, height_y

    def mirror(self, y: Any, a: Any) -> tuple[Any, Any]:
        """Return the mirror image of ``a`` as seen from ``y``, and the mirror's normal."""
        image, normal, _, _ = self._mirror(y, a)
        return image, normal

    def _lobe(self, a: Any, y: Any) -> AimLobe:
        """Return the aim from ``a`` at the mirror image of ``y``."""
        image, normal, height_a, height_y = self._mirror(a, y)
        return AimLobe.towards(a, image, normal, height_a, height_y, self._constant(3))

    def sample(self, a: Any, y: Any, u: Any, v: Any) -> Any:
        """Return directions from ``a`` that reach the surroundings of the mirrored ``y``."""
        return self._lobe(a, y).sample(u, v)

    def density(self, a: Any, y: Any, direction: Any) -> Any:
        """Return the density per solid angle with which ``sample`` finds ``direction``."""
        return self._lobe(a, y).density(direction)

    def area_density(self, a: Any, b: Any, normal: Any, y: Any) -> Any:
        """Return the density per area with which the bridge from ``a`` to ``y`` finds ``b``."""
        span = b - a
        squared = dr.maximum(dr.squared_norm(span), 1e-12)
        direction = span * dr.rsqrt(squared)
        return self.density(a, y, direction) * dr.abs(dr.dot(normal, direction)) / squared

    def join(self, scene: Any, y: Vertex, a: Vertex, u: Any, v: Any, active: Any, aim: Aim) -> Any:
        """Return the MIS-weighted contribution of light vertex ``y`` to facet ``a`` by a bridge."""
        active = active & (a.weight > 0)
        direction = self.sample(a.p, y.p, u, v)
        f_a, p_a, _ = scatter(a, direction, mi.TransportMode.Radiance, active)
        p_a = aim.mixed(a, direction, p_a)
        active = active & (dr.max(f_a) > 0)
        b, depth_ab, hit = cast(scene, a, direction, active)
        active = hit & ~b.diffuse & ~b.delta
        span = b.p - y.p
        squared = dr.squared_norm(span)
        w = span * dr.rsqrt(squared)
        f_y, p_y, _ = scatter(y, w, mi.TransportMode.Importance, active)
        f_b, p_b, _ = scatter(b, -w, mi.TransportMode.Radiance, active)
        density = self.density(a.p, y.p, direction)
        value = y.beta * f_y * f_b * f_a * a.beta / (squared * density)
        active = active & (dr.max(value) > 0) & (density > 0) & (squared > 0)
        depth_by, clear = optical_depth(scene, y, b, active)
        t_ab, t_by = dr.exp(-depth_ab), dr.exp(-depth_by)
        _, sigma_y = extinction(y.medium, active & y.volume)
        reach_y = dr.select(y.volume, dr.mean(sigma_y * t_by), dr.mean(t_by))
        # The camera finds b from the facet; then light is joined to b, or the camera finds y too.
        camera_b = p_a * dr.mean(t_ab) / density
        camera_y = p_b * area_factor(y, w) * reach_y / squared * y.vcm
        # Light finds b from y and is joined to the facet.
        here = density * area_factor(b, direction) / dr.squared_norm(b.p - a.p)
        light_b = p_y * area_factor(b, w) * dr.mean(t_by) / squared / here
        mis = 1.0 / (1.0 + camera_b * (1.0 + camera_y) + light_b)
        return dr.select(clear & active, value * t_ab * t_by * mis * y.weight, 0.0)
