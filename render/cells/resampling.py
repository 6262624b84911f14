"""Choosing which vertex of a light subpath is joined to the camera subpaths.

A light subpath scatters some twenty times, and each join costs several ray casts, but the few
vertices close to the diffuser's inner face carry nearly all of the light. So one vertex per
subpath is drawn in proportion to a *promise*: the light that it would send to a point of the
coating, directly and over the lower face, without visibility and with the medium ending at the
inner face. Weighted by total promise over its own promise, it stands for all of them: resampled
importance sampling (Talbot et al. 2005) with a reservoir. The promise is positive wherever a join
can be, so its errors cost time, not truth.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from render.cells.lower_face_mirror import Bridge
from render.geometry import fiber_poses
from render.paths.vertex import Vertex, extinction, is_smooth, value
from render.scene import Scene

# Optical depths are cut here: where the medium is not as thick as it seems, the promise is at
# most this far off (e^-6), and never 0.
DEPTH_MAX = 6.0
# What a rough face reflects below the critical angle, for the promise alone.
PARTIAL = 0.1
# Facets are tilted: added to the cosine at the untouched coating.
TILT = 0.3
# Least promise relative to isotropic scattering.
GLIMPSE = 0.03
# Most that a glossy vertex after a smooth one scatters: its lobe's peak belongs to the bridge.
GLARE = 4.0


class Promise:
    """The promise of light vertices at one bend: knows where the diffuser ends."""

    def __init__(self, scene: Scene, bend: float, bridge: Bridge) -> None:
        """Upload one plane per lit edge, the diffuser's inner face; ``bend`` in radians."""
        poses = fiber_poses(scene, bend)
        thickness = scene.diffuser.thickness if scene.diffuser else 0.0
        foot = poses.position + (scene.fibers.gap + thickness) * poses.inward
        planes: dict[tuple[float, ...], None] = {}
        for point, normal in zip(foot, poses.inward, strict=True):
            planes.setdefault((*np.round(normal, 6), float(np.round(point @ normal, 6))))
        self.planes = [mi.Float(list(plane)) for plane in planes]
        self.bridge = bridge
        # Total internal reflection begins at this squared cosine.
        self.critical = mi.Float(1.0 - scene.pad.index**-2.0)
        dr.make_opaque(self.planes, self.critical)

    def of(self, y: Vertex, after_smooth: Any, point: Any, normal: Any, active: Any) -> Any:
        """Return the promise of ``y`` for a point of the coating; positive where active.

        ``after_smooth`` says that the vertex before ``y`` is in a volume or diffuse; ``normal``
        is the untouched coating's, into the pad.
        """
        total = self._joined(y, after_smooth, point, normal, active)
        total += self._bridged(y, point, normal, active)
        return dr.select(active, total, 0.0)

    def _joined(self, y: Vertex, after_smooth: Any, point: Any, normal: Any, active: Any) -> Any:
        span = point - y.p
        squared = dr.maximum(dr.squared_norm(span), 1e-6)
        w = span * dr.rsqrt(squared)
        facing = dr.maximum(-dr.dot(normal, w), 0.0) + TILT
        # Other vertices of the camera subpaths may see what the facets do not.
        seen = self._scattered(y, w, active)
        bridged = after_smooth & ~is_smooth(y)
        seen = dr.select(bridged, dr.minimum(seen, GLARE), seen) + GLIMPSE * dr.mean(y.beta)
        return seen * facing / squared * self._transmittance(y, w, dr.sqrt(squared), active)

    def _bridged(self, y: Vertex, point: Any, normal: Any, active: Any) -> Any:
        active = active & is_smooth(y)
        image, face = self.bridge.mirror(y.p, point)
        span = image - y.p
        squared = dr.maximum(dr.squared_norm(span), 1e-6)
        w = span * dr.rsqrt(squared)
        onto = dr.dot(w, face)
        reflected = w - 2.0 * onto * face
        facing = dr.maximum(-dr.dot(normal, reflected), 0.0) + TILT
        beyond = dr.select(dr.square(onto) < self.critical, 1.0, PARTIAL)
        light = self._scattered(y, w, active) * facing * beyond / squared
        return light * self._transmittance(y, w, dr.sqrt(squared), active)

    def _reach(self, p: Any, direction: Any) -> Any:
        """Return the distance (mm) from ``p`` along ``direction`` to the diffuser's inner face."""
        longest = mi.Float(0.0)
        for plane in self.planes:
            x, y, z, level = (dr.gather(mi.Float, plane, mi.UInt32(i)) for i in range(4))
            normal = mi.Vector3f(x, y, z)
            depth = level - dr.dot(normal, p)
            cosine = dr.maximum(dr.dot(normal, direction), 1e-3)
            longest = dr.maximum(longest, depth / cosine)
        return longest

    def _transmittance(self, y: Vertex, w: Any, distance: Any, active: Any) -> Any:
        sigma = dr.mean(extinction(y.medium, active & y.volume)[1])
        length = dr.minimum(self._reach(y.p, w), distance)
        return dr.exp(-dr.minimum(sigma * length, DEPTH_MAX))

    def _scattered(self, y: Vertex, w: Any, active: Any) -> Any:
        return dr.mean(y.beta * value(y, w, mi.TransportMode.Importance, active))
