"""Emitters of a scene as starts of light subpaths and as targets of direct light.

Area, point and ``fiber`` emitters are known with their densities, as MIS needs them; any other
kind is refused by name. One emitter is chosen uniformly per sample.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from render.errors import RenderError
from render.optics.fiber_profile import angle, density, sample_direction, truncated_mass
from render.paths.connect import arrival_density, optical_depth
from render.paths.vertex import (
    Vertex,
    area_factor,
    empty_vertex,
    evaluate_scattering,
    surface_interaction,
)
from render.sampling.streams import HashedStream

AREA, POINT, FIBER = 0, 1, 2
_KINDS = {"AreaLight": AREA, "PointLight": POINT, "FiberEmitter": FIBER}


@dataclass
class EmittedRay:
    """A sampled start of a light subpath (a Dr.Jit PyTree).

    ``beta`` is emitted radiance over density; ``d_vcm`` and ``d_vc`` start the recursive MIS sums
    (Georgiev 2012, eqs. 31 and 32); ``medium`` is the one around the emitter.
    """

    o: mi.Point3f
    d: mi.Vector3f
    beta: mi.Spectrum
    d_vcm: mi.Float
    d_vc: mi.Float
    medium: mi.MediumPtr


class Emission:
    """All emitters of one Mitsuba scene."""

    def __init__(self, scene: mi.Scene) -> None:
        """Classify the emitters.

        Raises:
            RenderError: for a scene without emitters or with one that is not supported.
        """
        emitters = scene.emitters()
        if not emitters:
            raise RenderError(
                "the scene has no emitter, at least one is needed: area, point or fiber",
                field="emitter",
            )
        kinds, widths = [], []
        for emitter in emitters:
            # Emitters written in Python all share one class name in Mitsuba.
            name = type(emitter).__name__
            name = emitter.class_name() if name == "Emitter" else name
            if name not in _KINDS:
                raise RenderError(
                    f"emitter {name} is not supported, allowed: area, point, fiber",
                    field="emitter",
                    value=name,
                )
            kinds.append(_KINDS[name])
            widths.append(float(getattr(emitter, "sigma_v", 1.0)))
        self.count = len(emitters)
        self.scene = scene
        self.pointers = scene.emitters_dr()
        # Dr.Jit numbers the emitters of all scenes that are alive: number -> place in this scene.
        numbers = np.array(dr.reinterpret_array(mi.UInt32, self.pointers))
        places = np.zeros(int(numbers.max()) + 1, dtype=np.uint32)
        places[numbers] = np.arange(self.count)
        self.places = mi.UInt32(places)
        self.kind = mi.UInt32(kinds)
        self.sigma_v = mi.Float(widths)
        self.norm = mi.Float([truncated_mass(s) for s in widths])
        dr.make_opaque(self.kind, self.sigma_v, self.norm, self.places)

    def _profile(self, index: mi.UInt32, local: mi.Vector3f) -> mi.Float:
        """Return the density per solid angle of local directions from emitter ``index``."""
        kind = dr.gather(mi.UInt32, self.kind, index)
        sigma_v = dr.gather(mi.Float, self.sigma_v, index)
        norm = dr.gather(mi.Float, self.norm, index)
        cosine = dr.maximum(local.z, 0.0) / dr.pi
        fiber = density(angle(local), sigma_v, norm)
        sphere = 1.0 / (4.0 * dr.pi)
        return dr.select(kind == POINT, sphere, dr.select(kind == FIBER, fiber, cosine))

    def start(self, pick: mi.Float, square: mi.Point2f, u: mi.Float, v: mi.Float) -> EmittedRay:
        """Sample rays that leave the emitters."""
        index = dr.minimum(mi.UInt32(pick * self.count), self.count - 1)
        emitter = dr.gather(mi.EmitterPtr, self.pointers, index)
        kind = dr.gather(mi.UInt32, self.kind, index)
        ps, _ = emitter.sample_position(mi.Float(0.0), square)
        point = kind == POINT
        frame = mi.Frame3f(dr.select(point, mi.Normal3f(0, 0, 1), ps.n))
        cone = sample_direction(
            u, v, dr.gather(mi.Float, self.sigma_v, index), dr.gather(mi.Float, self.norm, index)
        )
        hemisphere = mi.warp.square_to_cosine_hemisphere(mi.Point2f(u, v))
        sphere = mi.warp.square_to_uniform_sphere(mi.Point2f(u, v))
        local = dr.select(point, sphere, dr.select(kind == FIBER, cone, hemisphere))
        d = frame.to_world(local)
        direction_pdf = self._profile(index, local)
        position_pdf = dr.select(point, 1.0, ps.pdf) / self.count
        radiance = self._radiance(emitter, index, ps.p, frame.n, d)
        cosine = dr.select(point, 1.0, dr.maximum(local.z, 0.0))
        pdf = position_pdf * direction_pdf
        offset = (1.0 + dr.max(dr.abs(ps.p))) * mi.math.RayEpsilon
        shape = emitter.get_shape()
        outside = dr.select(point, emitter.get_medium(), shape.exterior_medium())
        return EmittedRay(
            o=mi.Point3f(ps.p + dr.select(point, 0.0, offset) * mi.Vector3f(frame.n)),
            d=d,
            beta=dr.select(pdf > 0, radiance * cosine / pdf, 0.0),
            d_vcm=dr.select(direction_pdf > 0, 1.0 / direction_pdf, 0.0),
            # A camera subpath never meets a point.
            d_vc=dr.select(point | (pdf <= 0), 0.0, cosine / pdf),
            medium=outside,
        )

    def dark(self) -> bool:
        """Return whether no ray of a sample of them carries light: everything is switched off."""
        x, y, u, v = HashedStream(dr.arange(mi.UInt32, 64 * self.count)).event(mi.UInt32(0))
        pick = (dr.arange(mi.Float, 64 * self.count) + 0.5) / (64 * self.count)
        return not dr.any(dr.max(self.start(pick, mi.Point2f(x, y), u, v).beta) > 0)

    def _radiance(
        self, emitter: mi.EmitterPtr, index: mi.UInt32, p: mi.Point3f, n: mi.Normal3f,
        d: mi.Vector3f,
    ) -> mi.Spectrum:  # fmt: skip
        """Return radiance (intensity, for points) from ``p`` in direction ``d``."""
        point = dr.gather(mi.UInt32, self.kind, index) == POINT
        si = dr.zeros(mi.SurfaceInteraction3f)
        si.p, si.n, si.sh_frame = p, n, mi.Frame3f(n)
        si.wi = si.sh_frame.to_local(d)
        surface = emitter.eval(si, ~point)
        there = dr.zeros(mi.Interaction3f)
        there.p = p + d
        # At unit distance irradiance equals intensity.
        _, intensity = emitter.sample_direction(there, mi.Point2f(0.5), point)
        return dr.select(point, intensity, surface)

    def met(self, v: Vertex, d_vcm: mi.Float, active: mi.Bool) -> mi.Spectrum:
        """Return the MIS-weighted radiance of an emitter that a camera subpath runs into (s = 0).

        Georgiev 2012, eqs. 43 and 37; ``d_vcm`` is that of ``v``, or 0 where direct light cannot
        compete.
        """
        si = surface_interaction(v)
        active = active & ~v.volume
        emitter = si.emitter(self.scene, active)
        hit = active & (emitter != None)  # noqa: E711 (a Dr.Jit pointer array)
        radiance = emitter.eval(si, hit)
        number = dr.reinterpret_array(mi.UInt32, emitter)
        index = dr.gather(mi.UInt32, self.places, number, hit)
        position_pdf = dr.rcp(v.shape.surface_area()) / self.count
        ratio = position_pdf * (d_vcm + self._profile(index, si.wi) * v.d_vc)
        return dr.select(hit, v.beta * radiance / (1.0 + ratio), 0.0)

    def direct(
        self, scene: mi.Scene, v: Vertex, pick: mi.Float, square: mi.Point2f, active: mi.Bool
    ) -> mi.Spectrum:
        """Return the MIS-weighted direct light at camera vertex ``v`` (s = 1).

        Georgiev 2012, eqs. 44, 45 and 37, with positions sampled per area.
        """
        index = dr.minimum(mi.UInt32(pick * self.count), self.count - 1)
        emitter = dr.gather(mi.EmitterPtr, self.pointers, index)
        point = dr.gather(mi.UInt32, self.kind, index) == POINT
        ps, _ = emitter.sample_position(mi.Float(0.0), square, active)
        span = ps.p - v.p
        squared = dr.squared_norm(span)
        d = span * dr.rsqrt(squared)
        normal = dr.select(point, mi.Normal3f(-d), ps.n)
        radiance = self._radiance(emitter, index, ps.p, normal, -d)
        cosine = dr.select(point, 1.0, dr.maximum(-dr.dot(normal, d), 0.0))
        position_pdf = dr.select(point, 1.0, ps.pdf) / self.count
        active = active & (squared > 0) & (cosine > 0) & (dr.max(radiance) > 0)
        value, pdf, reverse = evaluate_scattering(v, d, mi.TransportMode.Radiance, active)
        value = v.beta * value * radiance * cosine / (squared * position_pdf)
        active = active & (dr.max(value) > 0)
        end = empty_vertex()
        end.p, end.n, end.shape = ps.p, normal, emitter.get_shape()
        # A point has no surface to step off: treat it like a vertex in a volume.
        end.volume = mi.Bool(point)
        depth, clear = optical_depth(scene, v, end, active)
        transmittance = dr.exp(-depth)
        arrival = arrival_density(v, transmittance, active)
        # Against a camera subpath that runs into the emitter, and light subpaths that reach v.
        hit = dr.select(
            point | v.terminal,
            0.0,
            pdf * cosine * dr.mean(transmittance) / (squared * position_pdf),
        )
        local = mi.Frame3f(normal).to_local(-d)
        light = self._profile(index, local) * area_factor(v, d) * arrival / squared
        mis = 1.0 / (1.0 + hit + light * (v.d_vcm + v.d_vc * reverse))
        return dr.select(active & clear, value * transmittance * mis, 0.0)
