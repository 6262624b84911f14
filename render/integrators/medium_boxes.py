"""Bounding boxes of media, for transmittances in weights that cast no ray.

A weight by which a connection is drawn may be wrong at the cost of noise. So the way through the
medium of a vertex ends, at the latest, at the box around that medium: where the medium is a flat
layer that is exact, and where it is bent, an upper bound of the optical depth.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from render.arrays import Array
from render.integrators.emitters import shape_corners
from render.paths.vertex import Vertex, extinction, leave

MEDIA_MAX = 4
"""Media that weights know, those of the first shapes; the others seem clear to them."""
OPTICAL_DEPTH_MAX = 4.0
"""Where optical depths in weights are cut: those are never 0."""
UNBOUNDED = 1e30
"""Half-width (mm) of the box of a medium that the camera is in: it has no end."""


class MediumBoxes:
    """Extinction (1/mm, mean over channels) and bounding box of the media of a scene."""

    def __init__(self, scene: mi.Scene, sensor: mi.Sensor) -> None:
        """Gather the media of all shapes and of the sensor."""
        parts: dict[Any, list[Array]] = {}
        for shape in scene.shapes():
            for medium in (shape.interior_medium(), shape.exterior_medium()):
                parts.setdefault(medium, []).append(shape_corners(shape))
        if sensor.get_medium() is not None:
            everywhere = np.array([[-UNBOUNDED] * 3, [UNBOUNDED] * 3])
            parts.setdefault(sensor.get_medium(), []).append(everywhere)
        parts.pop(None, None)
        self.media = [mi.MediumPtr(medium) for medium in parts][:MEDIA_MAX]
        self.sigma = [dr.mean(extinction(m, mi.Bool(True))[1]) for m in self.media]
        corners = [np.concatenate(part) for part in parts.values()][:MEDIA_MAX]
        self.low = [mi.Point3f(points.min(axis=0)) for points in corners]
        self.high = [mi.Point3f(points.max(axis=0)) for points in corners]
        # Literal numbers would be compiled into the kernels.
        dr.make_opaque(self.media, self.sigma, self.low, self.high)

    def transmittance(self, y: Vertex, p: mi.Point3f) -> mi.Float:
        """Return the transmittance from ``y`` to the end of its medium towards ``p``, or to it.

        By the mean extinction over channels, and at least e^-4; 1 outside of media.
        """
        origin, medium = leave(y, p - y.p)
        span = p - origin
        distance = dr.norm(span)
        inverse = dr.rcp(dr.select(span == 0.0, 1e-20, span / dr.maximum(distance, 1e-20)))
        depth = mi.Float(0.0)
        for known, sigma, low, high in zip(
            self.media, self.sigma, self.low, self.high, strict=True
        ):
            # The farther one of two parallel planes is where a ray from inside leaves.
            ends = dr.maximum((low - origin) * inverse, (high - origin) * inverse)
            within = dr.clip(dr.min(ends), 0.0, distance)
            depth = dr.select(medium == known, sigma * within, depth)
        return dr.exp(-dr.minimum(depth, OPTICAL_DEPTH_MAX))
