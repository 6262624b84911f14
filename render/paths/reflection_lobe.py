"""Directions about an axis with a bivariate t distribution in the plane tangent to the sphere.

Heavier tails than the reflection that it imitates, so that what it misses still has density.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

DEGREES_OF_FREEDOM = 3.0
"""Of the t distribution: heavy tails for imperfect mirror images."""
WIDTH_FACTOR = 1.2
"""Widths relative to a Beckmann lobe's standard deviation."""
MIN_WIDTH = 0.01
"""Least width in radians."""


@dataclass
class ReflectionLobe:
    """Unit ``axis``, two tangents, and the widths (tangents of angles) along each.

    ``wide`` belongs to ``along``, the tangent in the plane of incidence, ``narrow`` to ``across``.
    """

    axis: mi.Vector3f
    along: mi.Vector3f
    across: mi.Vector3f
    wide: mi.Float
    narrow: mi.Float

    @staticmethod
    def towards(
        a: mi.Point3f, image: mi.Point3f, normal: mi.Vector3f, height_a: mi.Float,
        height_y: mi.Float, slope: mi.Float,
    ) -> ReflectionLobe:  # fmt: skip
        """Aim from ``a`` at ``image``, the mirror image of a point ``y``.

        ``normal`` is the mirror's; the heights (mm) are those of ``a`` and ``y`` above it;
        ``slope`` is the standard deviation of the rough mirror's slopes.
        """
        distance = dr.norm(image - a)
        axis = (image - a) / dr.maximum(distance, 1e-6)
        across = dr.cross(axis, normal)
        aside = dr.select(dr.abs(normal.x) > 0.9, mi.Vector3f(0, 1, 0), mi.Vector3f(1, 0, 0))
        across = dr.select(dr.squared_norm(across) > 1e-8, dr.normalize(across), aside)
        along = dr.normalize(dr.cross(across, axis))
        across = dr.cross(axis, along)
        total = dr.maximum(height_a + height_y, 1e-6)
        wide = 2.0 * WIDTH_FACTOR * slope * height_y / total
        cosine = dr.minimum(total / dr.maximum(distance, 1e-6), 1.0)
        return ReflectionLobe(
            axis, along, across, dr.maximum(wide, MIN_WIDTH), dr.maximum(wide * cosine, MIN_WIDTH)
        )

    def sample(self, u: mi.Float, v: mi.Float) -> mi.Vector3f:
        """Return a direction for two uniform numbers."""
        nu = DEGREES_OF_FREEDOM
        radius = dr.sqrt(nu * (dr.power(dr.maximum(1.0 - u, 1e-7), -2.0 / nu) - 1.0))
        sin, cos = dr.sincos(2.0 * dr.pi * v)
        return dr.normalize(
            self.axis
            + radius * cos * self.wide * self.along
            + radius * sin * self.narrow * self.across
        )

    def density(self, direction: mi.Vector3f) -> mi.Float:
        """Return the density per solid angle with which ``sample`` finds ``direction``."""
        nu = DEGREES_OF_FREEDOM
        forward = dr.dot(direction, self.axis)
        s = dr.dot(direction, self.along) / forward
        t = dr.dot(direction, self.across) / forward
        quadratic = 1.0 + (dr.square(s / self.wide) + dr.square(t / self.narrow)) / nu
        plane = dr.power(quadratic, -0.5 * (nu + 2.0)) / (2.0 * dr.pi * self.wide * self.narrow)
        # From the tangent plane to the sphere: 1 / cos^3.
        jacobian = 1.0 + dr.square(s) + dr.square(t)
        return dr.select(forward > 1e-3, plane * jacobian * dr.sqrt(jacobian), 0.0)

    def area_density(
        self, a: mi.Point3f, b: mi.Point3f, normal: mi.Normal3f,
        probability: mi.Float | float = 1.0,
    ) -> mi.Float:  # fmt: skip
        """Return the density per area with which ``sample`` from ``a`` finds ``b``.

        ``normal`` is the surface's at ``b``; the lobe is drawn from with a ``probability``.
        """
        span = b - a
        squared = dr.maximum(dr.squared_norm(span), 1e-12)
        direction = span * dr.rsqrt(squared)
        cosine = dr.abs(dr.dot(normal, direction))
        return self.density(direction) * probability * cosine / squared
