"""The lower face of a pad as a mirror that connects facets to light vertices.

A third of a facet's light arrives by total internal reflection in the rough lower face. Connecting
straight to a vertex on that face mostly misses its narrow lobe. So the light vertex is mirrored in
the face, and a direction is drawn from the facet close to the mirror image, as wide as the
roughness makes the reflection. Its density is known for any path, so it is one more strategy of the
balance heuristic (``render.paths.connect.mirror_connection``).

On a bent pad the mirror is the plane that touches the face between both points: an approximation
of where directions are drawn only, never of the estimate.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from render.paths.reflection_lobe import ReflectionLobe
from render.scene import Scene

CURVATURE_MIN = 1e-4
"""Below this curvature (1/mm) times 1 mm the mirror is taken to be flat."""


class LowerFaceMirror:
    """The mirror of one pad at one bend."""

    def __init__(self, scene: Scene, bend: float) -> None:
        """Prepare the mirror at ``bend`` radians."""
        kappa = bend / scene.pad.length
        self.curved = kappa > CURVATURE_MIN
        # The lower face of a flat pad on a window is the window's.
        self.depth = scene.box.depth
        radius = 1.0 / kappa if self.curved else 0.0
        slope = scene.finish("lower").roughness / np.sqrt(2.0)
        self.constants = mi.Float(
            [scene.camera.pivot, scene.pad.thickness + radius, radius + scene.pad.thickness, slope]
        )
        dr.make_opaque(self.constants)

    def _constant(self, index: int) -> mi.Float:
        return dr.gather(mi.Float, self.constants, mi.UInt32(index))

    def _reflected(
        self, a: mi.Point3f, y: mi.Point3f
    ) -> tuple[mi.Point3f, mi.Vector3f, mi.Float, mi.Float]:
        """Return mirror image of ``y``, the mirror's normal, and both heights above it."""
        if not self.curved:
            image = mi.Point3f(y.x, y.y, -2.0 * self.depth - y.z)
            heights = dr.abs(a.z + self.depth), dr.abs(y.z + self.depth)
            return image, mi.Vector3f(0.0, 0.0, 1.0), *heights
        center_y, center_z, outer = (self._constant(i) for i in range(3))
        angle_a = dr.atan2(a.y - center_y, center_z - a.z)
        angle_y = dr.atan2(y.y - center_y, center_z - y.z)
        radius_a = dr.hypot(a.y - center_y, center_z - a.z)
        radius_y = dr.hypot(y.y - center_y, center_z - y.z)
        height_a = dr.abs(outer - radius_a)
        height_y = dr.abs(outer - radius_y)
        fraction = height_a / dr.maximum(height_a + height_y, 1e-6)
        sin, cos = dr.sincos(angle_a + fraction * (angle_y - angle_a))
        normal = mi.Vector3f(0.0, -sin, cos)
        foot = mi.Point3f(0.0, center_y + outer * sin, center_z - outer * cos)
        return y - 2.0 * dr.dot(y - foot, normal) * normal, normal, height_a, height_y

    def image(self, a: mi.Point3f, y: mi.Point3f) -> tuple[mi.Point3f, mi.Vector3f]:
        """Return the mirror image of ``a`` as seen from ``y``, and the mirror's normal."""
        image, normal, _, _ = self._reflected(y, a)
        return image, normal

    def lobe(self, a: mi.Point3f, y: mi.Point3f) -> ReflectionLobe:
        """Return the directions from ``a`` about the mirror image of ``y``."""
        image, normal, height_a, height_y = self._reflected(a, y)
        return ReflectionLobe.towards(a, image, normal, height_a, height_y, self._constant(3))

    def area_density(
        self, a: mi.Point3f, b: mi.Point3f, normal: mi.Normal3f, y: mi.Point3f
    ) -> mi.Float:
        """Return the density per area with which a connection from ``a`` to ``y`` finds ``b``."""
        return self.lobe(a, y).area_density(a, b, normal)
