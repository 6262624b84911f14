"""Lamps that camera subpaths meet (s = 0) and lamps that they are joined to (s = 1), in cells.

Light from outside the pad is a field of radiance over lines (``FiberLight.ray``): one line carries
light of every direction node. With the last vertex ``v`` of a camera subpath on the way to a lamp
and the direction ``d`` there, the balance heuristic (Veach 1997, sec. 9.2) compares, per area at
``v`` and solid angle of ``d``,

- s = 0: the density of ``v`` times that of ``d`` by scattering,
- s = 1: the density of ``v`` times that of points on the lamp, seen from ``v``,
- s >= 2: light subpaths that begin with the line, per projected area and solid angle.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from render.cells.fiber_light import FiberLight
from render.paths.connect import optical_depth
from render.paths.vertex import Vertex, area_factor, empty_vertex, evaluate_scattering
from render.paths.walk import GuidingDistribution, SubpathState
from render.sampling.streams import Numbers


@dataclass
class MetLamp:
    """The segment from ``p`` along ``d`` of a camera subpath that passed through a lamp.

    A Dr.Jit PyTree. ``weight`` is 1 / probability that it was kept, 0 where there is none; the sums
    are those of the segment (``render.paths.walk.SubpathState``).
    """

    p: mi.Point3f
    d: mi.Vector3f
    beta: mi.Spectrum
    depth: mi.Spectrum
    d_vcm: mi.Float
    d_vc: mi.Float
    weight: mi.Float

    @staticmethod
    def none() -> MetLamp:
        """Return a segment with weight 0, for loops that have not found one yet."""
        return MetLamp(
            dr.zeros(mi.Point3f), mi.Vector3f(0, 0, 1), mi.Spectrum(0), mi.Spectrum(0),
            mi.Float(0), mi.Float(0), mi.Float(0),
        )  # fmt: skip

    @staticmethod
    def of(state: SubpathState, p: mi.Point3f) -> MetLamp:
        """Return the segment that ``state`` goes on, from its last vertex ``p``."""
        return MetLamp(
            mi.Point3f(p), mi.Vector3f(state.d), mi.Spectrum(state.beta),
            mi.Spectrum(state.depth), mi.Float(state.d_vcm), mi.Float(state.d_vc), mi.Float(1),
        )  # fmt: skip


@dataclass
class Lamp:
    """The lamp of each lane: one of the fibers of ``light``.

    ``bare`` says that silicone and air have the same index, so that the coating sees the lamp.
    """

    light: FiberLight
    fiber: mi.UInt32
    bare: bool

    def met(self, segment: MetLamp) -> list[mi.Float]:
        """Return, per direction node, the light that a camera subpath has met (s = 0)."""
        ray = self.light.ray(self.fiber, segment.p, -segment.d)
        # The free path that let the segment through is part of its density, in the mean.
        relative = dr.exp(-segment.depth)
        through = dr.mean(relative)
        value = dr.mean(segment.beta * relative) / through * segment.weight
        ratio = ray.joined * segment.d_vcm / through + ray.emitted * segment.d_vc
        return _scaled(ray.radiance, value / (1.0 + ratio), segment.weight > 0)

    def joined(
        self, scene: mi.Scene, z: Vertex, numbers: Numbers, guiding: GuidingDistribution
    ) -> list[mi.Float]:
        """Return, per direction node, the light of the lamp joined to camera vertex ``z``."""
        pick, x, y, _ = numbers
        active = (z.weight > 0) & ~z.volume & ~z.delta
        point = self.light.towards(self.fiber, z.p, pick, mi.Point2f(x, y))
        span = point - z.p
        w = span * dr.rsqrt(dr.maximum(dr.squared_norm(span), 1e-20))
        ray = self.light.ray(self.fiber, z.p, -w)
        active &= ray.joined > 0
        f, pdf, reverse = evaluate_scattering(z, w, mi.TransportMode.Radiance, active)
        pdf = dr.select(guiding.applies(z), guiding.mixture_pdf(z, w, pdf), pdf)
        active &= dr.max(f) > 0
        end = empty_vertex()
        # No surface to step off: like a vertex in a volume.
        end.p, end.volume = point, mi.Bool(True)
        depth, clear = optical_depth(scene, z, end, active)
        transmittance = dr.exp(-depth)
        through = dr.mean(transmittance)
        by_light = ray.emitted * area_factor(z, w) * (z.d_vcm + z.d_vc * reverse)
        mis = ray.joined / (ray.joined + through * (pdf + by_light))
        value = dr.mean(z.beta * f * transmittance) * z.weight * mis / ray.joined
        return _scaled(ray.radiance, value, active & clear)


def _scaled(radiance: list[mi.Float], scale: mi.Float, active: mi.Bool) -> list[mi.Float]:
    return [dr.select(active & (value > 0), value * scale, 0.0) for value in radiance]
