"""Choosing which vertex of a light subpath is joined to the camera subpath.

A light subpath scatters some forty times in the diffuser, and each join costs several ray casts,
but the few vertices close to the diffuser's inner face carry nearly all of the light. So one
vertex per subpath is drawn in proportion to a *promise*: the join's value without visibility and
MIS weight, with the medium ending at the inner face. Weighted by total promise over its own
promise, it stands for all of them: resampled importance sampling (Talbot et al. 2005) with a
reservoir. The promise is positive wherever the join can be, so its errors cost time, not truth.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from render.bridge import Bridge
from render.layout import fiber_poses
from render.scene import Scene
from render.vertex import Vertex, extinction, value

# Optical depths are cut here: where the medium is not as thick as it seems, the promise is at
# most this far off (e^-6), and never 0.
DEPTH_MAX = 6.0
# What a rough face reflects below the critical angle, for the promise alone.
PARTIAL = 0.1
# Facets glimpsed over a rough reflection are never quite edge-on.
GRAZING = 0.05
# Least promise relative to isotropic scattering onto a white facet.
GLIMPSE = 0.02 / np.pi**2


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

    def of(self, y: Vertex, facet: Vertex, active: Any) -> Any:
        """Return the promise of light vertex ``y`` for the facet; positive where active."""
        return dr.select(
            active, self._joined(y, facet, active) + self._bridged(y, facet, active), 0.0
        )

    def _joined(self, y: Vertex, facet: Vertex, active: Any) -> Any:
        span = facet.p - y.p
        squared = dr.maximum(dr.squared_norm(span), 1e-6)
        w = span * dr.rsqrt(squared)
        facing = dr.mean(facet.beta * value(facet, -w, mi.TransportMode.Radiance, active))
        seen = self._scattered(y, w, active) * facing
        # Other vertices of the camera subpath may see what the facet does not.
        least = GLIMPSE * dr.mean(y.beta) * dr.mean(facet.beta)
        return (seen + least) / squared * self._transmittance(y, w, active)

    def _bridged(self, y: Vertex, facet: Vertex, active: Any) -> Any:
        active = active & (y.volume | y.diffuse)
        image, normal = self.bridge.mirror(y.p, facet.p)
        span = image - y.p
        squared = dr.maximum(dr.squared_norm(span), 1e-6)
        w = span * dr.rsqrt(squared)
        onto = dr.dot(w, normal)
        reflected = w - 2.0 * onto * normal
        cosine = dr.maximum(-dr.dot(facet.frame.n, reflected), GRAZING)
        beyond = dr.select(dr.square(onto) < self.critical, 1.0, PARTIAL)
        light = self._scattered(y, w, active) * dr.mean(facet.beta) * (cosine / dr.pi)
        return light * beyond / squared * self._transmittance(y, w, active)

    def _transmittance(self, y: Vertex, w: Any, active: Any) -> Any:
        sigma = dr.mean(extinction(y.medium, active & y.volume)[1])
        return dr.exp(-dr.minimum(sigma * self._reach(y.p, w), DEPTH_MAX))

    def _scattered(self, y: Vertex, w: Any, active: Any) -> Any:
        return dr.mean(y.beta * value(y, w, mi.TransportMode.Importance, active))
