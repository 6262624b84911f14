"""Directions about an axis with a bivariate t distribution in the plane tangent to the sphere.

Heavier tails than the reflection that it imitates, so that what the aim misses still has density.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

# Degrees of freedom: heavy tails for imperfect mirror images.
TAIL = 3.0
# Widths relative to a Beckmann lobe's standard deviation, and their least value in radians.
WIDEN, LEAST = 1.2, 0.01


@dataclass
class AimLobe:
    """Unit ``axis``, two tangents, and the scale (tangent of the angle) along each."""

    axis: Any
    along: Any
    across: Any
    wide: Any
    narrow: Any

    @staticmethod
    def towards(
        a: Any, image: Any, normal: Any, height_a: Any, height_y: Any, slope: Any
    ) -> AimLobe:
        """Aim from ``a`` at ``image``, the mirror image of a point ``y``.

        ``normal`` is the mirror's; the heights (mm) are those of ``a`` and ``y`` above it;
        ``slope`` is the standard deviation of the rough mirror's slopes.
        """
        reach = dr.norm(image - a)
        axis = (image - a) / dr.maximum(reach, 1e-6)
        across = dr.cross(axis, normal)
        aside = dr.select(dr.abs(normal.x) > 0.9, mi.Vector3f(0, 1, 0), mi.Vector3f(1, 0, 0))
        across = dr.select(dr.squared_norm(across) > 1e-8, dr.normalize(across), aside)
        along = dr.normalize(dr.cross(across, axis))
        across = dr.cross(axis, along)
        total = dr.maximum(height_a + height_y, 1e-6)
        wide = 2.0 * WIDEN * slope * height_y / total
        cosine = dr.minimum(total / dr.maximum(reach, 1e-6), 1.0)
        return AimLobe(
            axis, along, across, dr.maximum(wide, LEAST), dr.maximum(wide * cosine, LEAST)
        )

    def sample(self, u: Any, v: Any) -> Any:
        """Return a direction for two uniform numbers."""
        radius = dr.sqrt(TAIL * (dr.power(dr.maximum(1.0 - u, 1e-7), -2.0 / TAIL) - 1.0))
        sin, cos = dr.sincos(2.0 * dr.pi * v)
        return dr.normalize(
            self.axis
            + radius * cos * self.wide * self.along
            + radius * sin * self.narrow * self.across
        )

    def density(self, direction: Any) -> Any:
        """Return the density per solid angle with which ``sample`` finds ``direction``."""
        forward = dr.dot(direction, self.axis)
        s = dr.dot(direction, self.along) / forward
        t = dr.dot(direction, self.across) / forward
        spread = 1.0 + (dr.square(s / self.wide) + dr.square(t / self.narrow)) / TAIL
        plane = dr.power(spread, -0.5 * (TAIL + 2.0)) / (2.0 * dr.pi * self.wide * self.narrow)
        cube = 1.0 + dr.square(s) + dr.square(t)
        return dr.select(forward > 1e-3, plane * cube * dr.sqrt(cube), 0.0)
