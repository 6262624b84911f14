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
from render.cells.lamp_aim import LampAim, Way
from render.paths.connect import optical_depth
from render.paths.vertex import (
    Vertex,
    area_factor,
    channel_mean,
    empty_vertex,
    evaluate_scattering,
    leave,
)
from render.paths.walk import (
    GuidingDistribution,
    SubpathState,
    begin_subpath,
    guided_pdf,
    sample_scattering,
    trace_segment,
)
from render.sampling.streams import Numbers, Stream

AIMED_EVENTS = 8
"""Events that an aimed subpath may take."""


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
        # Light subpaths arrive in a volume by its extinction, the same in all channels of cells.
        by_volume = dr.select(state.from_volume, channel_mean(state.sigma_from), 1.0)
        return MetLamp(
            mi.Point3f(p), mi.Vector3f(state.d), mi.Spectrum(state.beta), mi.Spectrum(state.depth),
            mi.Float(state.d_vcm), state.d_vc * by_volume, mi.Float(1),
        )  # fmt: skip


@dataclass
class Lamp:
    """The lamp of each lane: one of the fibers of ``light``.

    ``bare`` says that silicone and air have the same index, so that the coating sees the lamp.
    """

    light: FiberLight
    fiber: mi.UInt32
    bare: bool

    def passed(
        self, segment: MetLamp, begin: mi.Point3f, state: SubpathState, v: Vertex,
        arrived: mi.Bool, escaped: mi.Bool,
    ) -> mi.Bool:  # fmt: skip
        """Return whether a ray of ``segment`` from ``begin`` has passed through the lamp.

        ``state`` and the rest are what ``trace_segment`` returned for it; the segment's optical
        depth is set to that at its end.
        """
        segment.depth = state.depth
        length = dr.norm(dr.select(arrived, v.p, state.o) - begin)
        length = dr.select(escaped, dr.inf, length)
        return self.light.passed(self.fiber, begin, segment.d, length)

    def met(self, segment: MetLamp) -> list[mi.Float]:
        """Return, per direction node, the light that a camera subpath has met (s = 0)."""
        ray = self.light.ray(self.fiber, segment.p, -segment.d)
        # The free path that let the segment through is part of its density, in the mean.
        relative = dr.exp(-segment.depth)
        through = channel_mean(relative)
        value = channel_mean(segment.beta * relative) / through * segment.weight
        ratio = ray.joined * segment.d_vcm / through + ray.emitted * segment.d_vc
        return _scaled(ray.radiance, value / (1.0 + ratio), segment.weight > 0)

    def joined(
        self, scene: mi.Scene, z: Vertex, numbers: Numbers, guiding: GuidingDistribution
    ) -> list[mi.Float]:
        """Return, per direction node, the light of the lamp joined to camera vertex ``z``."""
        pick, x, y, _ = numbers
        active = (z.weight > 0) & ~z.delta
        if self.light.cast_in is None:
            active &= ~z.volume
        point, _ = self.light.sample_position(self.fiber, pick, mi.Point2f(x, y))
        span = point - z.p
        w = span * dr.rsqrt(dr.maximum(dr.squared_norm(span), 1e-20))
        ray = self.light.ray(self.fiber, z.p, -w)
        active &= ray.joined > 0
        f, pdf, reverse = evaluate_scattering(z, w, mi.TransportMode.Radiance, active)
        pdf = guided_pdf(guiding, z, w, pdf)
        if self.light.cast_in is not None:
            pdf = dr.select(z.terminal, 0.0, pdf)
        active &= dr.max(f) > 0
        end = empty_vertex()
        # No surface to step off: like a vertex in a volume.
        end.p, end.volume = point, mi.Bool(True)
        depth, clear = optical_depth(scene, z, end, active)
        transmittance = dr.exp(-depth)
        through = channel_mean(transmittance)
        by_light = ray.emitted * area_factor(z, w) * (z.d_vcm + z.d_vc * reverse)
        mis = ray.joined / (ray.joined + through * (pdf + by_light))
        value = channel_mean(z.beta * f * transmittance) * z.weight * mis / ray.joined
        return _scaled(ray.radiance, value, active & clear)


@dataclass
class AimedSubpaths:
    """Subpaths from a facet of smooth faces to its lamp, one more for each of the main ways.

    No other strategy finds light that comes from a lamp over smooth faces alone, so each facet
    gets a direction of every main way of ``LampAim`` beside the one that its camera subpath draws
    from the mixture. The balance heuristic counts all of them (Veach 1997, sec. 9.2.2).
    """

    lamp: Lamp
    aim: LampAim
    guiding: GuidingDistribution

    def share(self, facet: Vertex, direction: mi.Vector3f, mixture_pdf: mi.Float) -> mi.Float:
        """Return the camera subpath's share of light that comes straight from ``direction``."""
        return mixture_pdf / (mixture_pdf + self._density(facet, direction))

    def _density(self, facet: Vertex, direction: mi.Vector3f) -> mi.Float:
        densities = [
            self.aim.way_density(self.lamp.fiber, facet.p, way, direction)
            for way in self.aim.main_ways
        ]
        return sum(densities[1:], densities[0])

    def light(
        self, scene: mi.Scene, facet: Vertex, stream: Stream, event: mi.UInt32
    ) -> list[mi.Float]:
        """Return, per direction node, the light that the aimed subpaths find.

        Their numbers begin at ``event``.
        """
        sums = [mi.Float(0.0)] * self.lamp.light.nodes
        for way in self.aim.main_ways:
            met = self._trace(scene, facet, way, stream, event)
            for j, value in enumerate(self.lamp.met(met)):
                sums[j] = sums[j] + value
            event = event + AIMED_EVENTS
        return sums

    @dr.syntax
    def _trace(
        self, scene: mi.Scene, facet: Vertex, way: Way, stream: Stream, event: mi.UInt32
    ) -> MetLamp:
        """Return where a direction of ``way`` passes through the lamp, over delta faces alone."""
        x, y, free, _ = stream.event(event)
        direction = self.aim.sample_way(self.lamp.fiber, facet.p, way, x, y)
        active = facet.weight > 0
        value, pdf, _ = evaluate_scattering(facet, direction, mi.TransportMode.Radiance, active)
        density = self.guiding.mixture_pdf(facet, direction, pdf) + self._density(facet, direction)
        origin, medium = leave(facet, direction)
        # No other strategy competes: the sums of the balance heuristic are 0.
        state = begin_subpath(
            origin, direction, medium, facet.beta * value / density, mi.Float(0), mi.Float(0), free
        )
        active = active & (dr.max(value) > 0)
        met = MetLamp.none()
        count = mi.UInt32(1)
        # Without a face between, a facet is joined to a lamp in the pad (s = 1).
        late = mi.Bool(True)
        if self.lamp.light.cast_in is not None:
            late = ~dr.gather(mi.Bool, self.lamp.light.cast_in, self.lamp.fiber)
        while active:
            segment, begin = MetLamp.of(state, state.o), mi.Point3f(state.o)
            state, v, arrived, escaped = trace_segment(scene, state, active)
            passed = active & self.lamp.passed(segment, begin, state, v, arrived, escaped)
            # A subpath that comes back to the lamp is left to the camera subpath.
            met = dr.select(passed & late & (met.weight == 0), segment, met)
            going = arrived & v.delta
            late |= going
            state, alive = sample_scattering(
                state, v, mi.TransportMode.Radiance, stream.event(event + count), going
            )
            state.d_vcm, state.d_vc = mi.Float(0.0), mi.Float(0.0)
            count += 1
            active &= ~escaped & (~arrived | (going & alive)) & (count < AIMED_EVENTS)
        return met


def _scaled(radiance: list[mi.Float], scale: mi.Float, active: mi.Bool) -> list[mi.Float]:
    return [dr.select(active & (value > 0), value * scale, 0.0) for value in radiance]
