"""A first look at many light vertices, by which a few are drawn for a promise.

A *glimpse* of a join is what fits into a few dozen operations: power, distance, how both ends
roughly scatter, and the distance below which other strategies take over. No ray is cast, and no
BSDF is asked. It is positive wherever a promise can be (``render.integrators.target_weights``), so
its errors cost time, not truth: resampling in two steps, as ReSTIR does from many lights (Bitterli
et al. 2020, "Spatiotemporal reservoir resampling").
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from render.integrators.camera_subpaths import Kept
from render.integrators.light_subpaths import LightVertex
from render.paths.vertex import extinction, is_smooth

# Least that a vertex seems to scatter, relative to all directions alike.
LEAST = 0.05
# 1 / average of the lobe of a volume over all directions, 1 / 5 + LEAST.
AVERAGE = 4.0
# Width of the lobes of glossy vertices, as 1 - cosine.
WIDTH = 0.1
# Optical depths are cut here.
DEPTH_MAX = 4.0


@dataclass
class Seen:
    """What a glimpse knows of light vertices: evaluated arrays ``(slot, lane)``."""

    p: Any
    wi: Any
    power: Any
    volume: Any
    smooth: Any
    edges: Any
    vcm: Any
    vc: Any
    vc_open: Any

    @staticmethod
    def of(kept: LightVertex, shares: Any) -> Seen:
        """Return it; each vertex stands for ``shares``, and its power is that of all of them."""
        v = kept.vertex
        sigma = dr.mean(extinction(v.medium, v.volume & (shares > 0))[1])
        # Sums of balance heuristics per density per solid angle, for isotropic scattering.
        per = dr.select(v.volume, sigma / (4.0 * dr.pi), 0.0)
        seen = Seen(
            v.p, v.wi, dr.mean(v.beta) * shares, v.volume, is_smooth(v), kept.edges,
            per * v.vcm, per * v.vc / (4.0 * dr.pi), per * v.vc_open[0] / (4.0 * dr.pi),
        )  # fmt: skip
        dr.eval(seen)
        return seen


@dataclass
class Look:
    """A kept camera vertex as glimpses know it (a Dr.Jit PyTree)."""

    p: Any
    there: Any
    edges: Any
    left: Any
    terminal: Any
    volume: Any
    diffuse: Any
    n: Any
    ahead: Any
    mirror: Any
    sigma: Any
    vcm: Any
    vc: Any

    @staticmethod
    def of(end: Kept) -> Look:
        """Prepare the camera vertex ``end``."""
        z = end.vertex
        n = mi.Vector3f(z.frame.n)
        n = dr.select(dr.dot(n, z.wi) < 0, -n, n)
        sigma = dr.mean(extinction(z.medium, z.volume)[1])
        per = dr.select(z.volume, sigma / (4.0 * dr.pi), 0.0)
        return Look(
            z.p, z.weight > 0, end.edges, end.left, z.terminal, z.volume, z.diffuse, n, -z.wi,
            2.0 * dr.dot(n, z.wi) * n - z.wi, sigma, per * z.vcm, per * z.vc / (4.0 * dr.pi),
        )  # fmt: skip

    def scattered(self, w: Any) -> Any:
        """Return roughly what is scattered between ``w``, away from the vertex, and the camera."""
        ahead, mirror = dr.dot(w, self.ahead), dr.dot(w, self.mirror)
        volume = onward(ahead)
        diffuse = dr.maximum(dr.dot(w, self.n), 0.0)
        glossy = dr.square(WIDTH / (WIDTH + 1.0 - dr.maximum(ahead, mirror)))
        return LEAST + dr.select(self.volume, volume, dr.select(self.diffuse, diffuse, glossy))


def onward(cosine: Any) -> Any:
    """Return the shape of a forward lobe, 1 straight ahead, like that of milky media."""
    return dr.square(dr.square(0.5 * (1.0 + cosine)))


def glimpse(y: Seen, look: Look) -> Any:
    """Return roughly what ``y`` sends to the camera vertex of ``look``; at least a little."""
    span = y.p - look.p
    squared = dr.squared_norm(span)
    distance = dr.sqrt(squared)
    inside = y.volume & look.volume
    depth = dr.select(inside, dr.minimum(look.sigma * distance, DEPTH_MAX), 0.0)
    w = span / dr.maximum(distance, 1e-20)
    clear = dr.exp(-depth)
    from_y = dr.select(y.volume, LEAST + onward(dr.dot(w, y.wi)), 1.0)
    from_z = look.scattered(w)
    # Where other strategies find the same light more easily, balance takes 1 / distance^2 away:
    # the lobes are those of a volume, relative to all directions alike.
    to_y, to_z = AVERAGE * from_z, AVERAGE * from_y
    # A camera subpath that goes on to ``y`` may pass it, if that is one of those left.
    beyond = dr.select(look.left > 1, y.vc_open, dr.select(look.left == 1, y.vc, 0.0))
    near = dr.select(look.terminal, 0.0, to_y * (y.vcm + beyond * to_z))
    near += to_z * (look.vcm + look.vc * to_y)
    sent = y.power * clear * from_y * from_z
    return sent / dr.clip(squared + clear * near, 1e-12, 1e20)
