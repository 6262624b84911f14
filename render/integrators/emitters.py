"""Emitters of a scene as starts of light subpaths and as targets of direct light.

Known with their densities, as MIS needs them, are surfaces (area, ``fiber``, ``measured_light``),
points (point, spot) and what shines from infinitely far (directional, constant, envmap); any other
kind is refused by name. One emitter is chosen uniformly per sample.

Light from afar comes in parallel through a disk as large as the scene's bounding sphere: there a
direction is what a place is on a surface, and the disk's density per area what the density of
directions is (Georgiev 2012, sec. 5; SmallVCM). Mitsuba's spheres of such emitters are not used.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from render.arrays import Array
from render.errors import RenderError
from render.integrators.supported_content import class_of
from render.integrators.supported_plugins import PLUGINS
from render.optics.fiber_profile import angle, density, sample_direction, truncated_mass
from render.optics.measured_profile import STEPS, measured_density, sample_measured
from render.paths.connect import density_at, optical_depth
from render.paths.vertex import (
    RATIO_MAX,
    Vertex,
    channel_mean,
    empty_vertex,
    surface_interaction,
)
from render.paths.walk import SubpathState
from render.sampling.streams import HashedStream

AREA, POINT, FIBER, SPOT, MEASURED, DIRECTIONAL, ENVIRONMENT = range(7)
_KINDS = {
    "AreaLight": AREA, "PointLight": POINT, "FiberEmitter": FIBER, "SpotLight": SPOT,
    "MeasuredEmitter": MEASURED, "DirectionalEmitter": DIRECTIONAL,
    "ConstantBackgroundEmitter": ENVIRONMENT, "EnvironmentMapEmitter": ENVIRONMENT,
}  # fmt: skip
SPHERE_MARGIN = 1.001
"""Radius of the disk that light from afar comes through, over the bounding sphere's."""


@dataclass
class EmittedRay:
    """A sampled start of a light subpath (a Dr.Jit PyTree).

    ``beta`` is emitted radiance over density; ``d_vcm`` and ``d_vc`` start the recursive MIS sums
    (Georgiev 2012, eqs. 31 and 32); ``medium`` is the one around the emitter; ``parallel`` says
    that the ray comes from infinitely far.
    """

    o: mi.Point3f
    d: mi.Vector3f
    beta: mi.Spectrum
    d_vcm: mi.Float
    d_vc: mi.Float
    medium: mi.MediumPtr
    parallel: mi.Bool


@dataclass
class LightSample:
    """A place on an emitter as a vertex sees it, or a direction from afar (a Dr.Jit PyTree).

    ``d`` points to it. ``received`` is radiance times ``cosine / squared`` over ``pdf``, which is
    the density of the place per area (of a direction per solid angle); ``emitted`` is the density
    per solid angle (from afar: per area) with which light subpaths leave it along ``-d``.
    ``delta``: camera subpaths cannot meet it.
    """

    end: Vertex
    d: mi.Vector3f
    received: mi.Spectrum
    pdf: mi.Float
    cosine: mi.Float
    squared: mi.Float
    emitted: mi.Float
    delta: mi.Bool


class Emission:
    """All emitters of one Mitsuba scene."""

    def __init__(self, scene: mi.Scene, around: mi.Sensor | None = None) -> None:
        """Classify the emitters, which are of supported kinds.

        Light may also be in the medium ``around`` a camera.

        Raises:
            RenderError: for a scene without emitters.
        """
        emitters = scene.emitters()
        if not emitters:
            raise RenderError(
                "the scene has no emitter (those of surfaces go into their shapes), at least one "
                f"is needed: {', '.join(PLUGINS['emitter'])}",
                field="emitter",
            )
        kinds, widths, firsts = [], [], []
        tables = [np.linspace(0.0, 1.0, STEPS + 1, dtype=np.float32)]
        for emitter in emitters:
            kind = _KINDS[class_of(emitter)]
            kinds.append(kind)
            widths.append(float(getattr(emitter, "sigma_v", 1.0)))
            firsts.append(len(tables) * (STEPS + 1) if kind == MEASURED else 0)
            if kind == MEASURED:
                tables.append(emitter.step_sums)
        self.count = len(emitters)
        self.media = any(_has_medium(part) for part in (*scene.shapes(), *emitters, around))
        self.nulls = any(map(_may_be_null, scene.shapes()))
        self.kinds = frozenset(kinds)
        # Places on these are not drawn evenly.
        self.textured = {
            i: emitter
            for i, emitter in enumerate(emitters)
            if kinds[i] == AREA and mi.has_flag(emitter.flags(), mi.EmitterFlags.SpatiallyVarying)
        }
        self.scene = scene
        # Dr.Jit calls a single emitter without a table of functions.
        self.only = emitters[0] if self.count == 1 else None
        self.pointers = scene.emitters_dr()
        # Dr.Jit numbers the emitters of all scenes that are alive: number -> place in this scene.
        numbers = np.array(dr.reinterpret_array(mi.UInt32, self.pointers))
        places = np.zeros(int(numbers.max()) + 1, dtype=np.uint32)
        places[numbers] = np.arange(self.count)
        self.places = mi.UInt32(places)
        self.kind = mi.UInt32(kinds)
        self.sigma_v = mi.Float(widths)
        self.norm = mi.Float([truncated_mass(s) for s in widths])
        self.table, self.first = mi.Float(np.concatenate(tables)), mi.UInt32(firsts)
        self.cutoff = mi.Float([_versine(e, k) for e, k in zip(emitters, kinds, strict=True)])
        self.area = mi.Float([_area(e, k) for e, k in zip(emitters, kinds, strict=True)])
        center, radius = bounding_sphere(scene)
        self.center, self.radius = mi.Point3f(center), mi.Float(SPHERE_MARGIN * radius)
        dr.make_opaque(
            self.kind, self.sigma_v, self.norm, self.places, self.table, self.first, self.cutoff,
            self.area, self.center, self.radius,
        )  # fmt: skip

    def _has(self, *kinds: int) -> bool:
        """Return whether the scene has emitters of such kinds."""
        return not self.kinds.isdisjoint(kinds)

    def _is(self, index: mi.UInt32, *kinds: int) -> mi.Bool:
        """Return whether the emitters ``index`` are of one of the kinds."""
        if not self._has(*kinds) or self.kinds <= set(kinds):
            return mi.Bool(self._has(*kinds))  # known when kernels are compiled
        kind, result = dr.gather(mi.UInt32, self.kind, index), mi.Bool(False)
        for k in kinds:
            result |= kind == k
        return result

    def _profile(self, index: mi.UInt32, local: mi.Vector3f) -> mi.Float:
        """Return the density per solid angle of local directions from emitter ``index``."""
        pdf = dr.maximum(local.z, 0.0) / dr.pi
        if self._has(FIBER):
            sigma_v = dr.gather(mi.Float, self.sigma_v, index)
            fiber = density(angle(local), sigma_v, dr.gather(mi.Float, self.norm, index))
            pdf = dr.select(self._is(index, FIBER), fiber, pdf)
        if self._has(MEASURED):
            first = dr.gather(mi.UInt32, self.first, index)
            measured = measured_density(angle(local), self.table, first)
            pdf = dr.select(self._is(index, MEASURED), measured, pdf)
        if self._has(POINT, SPOT):
            # All directions, or a cone, evenly.
            cutoff = dr.gather(mi.Float, self.cutoff, index)
            cone = dr.select(1.0 - local.z <= cutoff, 0.5 / (dr.pi * cutoff), 0.0)
            cone = dr.select(self._is(index, POINT), 0.25 / dr.pi, cone)
            pdf = dr.select(self._is(index, POINT, SPOT), cone, pdf)
        return pdf

    def _sample_profile(self, index: mi.UInt32, u: mi.Float, v: mi.Float) -> mi.Vector3f:
        """Return local directions with that density."""
        local = mi.warp.square_to_cosine_hemisphere(mi.Point2f(u, v))
        if self._has(FIBER):
            sigma_v = dr.gather(mi.Float, self.sigma_v, index)
            fiber = sample_direction(u, v, sigma_v, dr.gather(mi.Float, self.norm, index))
            local = dr.select(self._is(index, FIBER), fiber, local)
        if self._has(MEASURED):
            first = dr.gather(mi.UInt32, self.first, index)
            measured = sample_measured(u, v, self.table, first)
            local = dr.select(self._is(index, MEASURED), measured, local)
        if self._has(POINT, SPOT):
            below = u * dr.gather(mi.Float, self.cutoff, index)
            sine = dr.sqrt(dr.maximum(below * (2.0 - below), 0.0))
            s, c = dr.sincos(2.0 * dr.pi * v)
            cone = mi.Vector3f(sine * c, sine * s, 1.0 - below)
            local = dr.select(self._is(index, POINT, SPOT), cone, local)
        return local

    def _picked(
        self, pick: mi.Float
    ) -> tuple[mi.UInt32, mi.EmitterPtr | mi.Emitter, mi.Bool, mi.Bool]:
        """Return the number of an emitter, itself, and whether it is afar or a point."""
        index = dr.minimum(mi.UInt32(pick * self.count), self.count - 1)
        emitter = dr.gather(mi.EmitterPtr, self.pointers, index)
        if self.only is not None:
            index, emitter = mi.UInt32(0), self.only
        afar = self._is(index, DIRECTIONAL, ENVIRONMENT)
        return index, emitter, afar, self._is(index, POINT, SPOT)

    def start(self, pick: mi.Float, square: mi.Point2f, u: mi.Float, v: mi.Float) -> EmittedRay:
        """Sample rays that leave the emitters."""
        index, emitter, parallel, point = self._picked(pick)
        ps, _ = emitter.sample_position(mi.Float(0.0), square, ~parallel)
        frame = mi.Frame3f(
            dr.select(point & (dr.squared_norm(ps.n) == 0), mi.Normal3f(0, 0, 1), ps.n)
        )
        local = self._sample_profile(index, u, v)
        d = frame.to_world(local)
        direction_pdf = self._profile(index, local)
        position_pdf = dr.select(point, 1.0, ps.pdf) / self.count
        radiance = self._radiance(emitter, point, ps, mi.Vector3f(frame.n), d)
        cosine = dr.select(point, 1.0, dr.maximum(local.z, 0.0))
        pdf = position_pdf * direction_pdf
        offset = (1.0 + dr.max(dr.abs(ps.p))) * mi.math.RayEpsilon
        pointer = mi.EmitterPtr(emitter)
        shape = pointer.get_shape()
        outside = dr.select(point, pointer.get_medium(), shape.exterior_medium())
        ray = EmittedRay(
            o=mi.Point3f(ps.p + dr.select(point, 0.0, offset) * mi.Vector3f(frame.n)),
            d=d,
            beta=dr.select(pdf > 0, radiance * cosine / pdf, 0.0),
            d_vcm=dr.select(direction_pdf > 0, 1.0 / direction_pdf, 0.0),
            # A camera subpath never meets a point.
            d_vc=dr.select(point | (pdf <= 0), 0.0, cosine / pdf),
            medium=outside,
            parallel=parallel,
        )
        if self._has(DIRECTIONAL, ENVIRONMENT):
            ray = dr.select(parallel, self._parallel_ray(index, emitter, square, u, v), ray)
        return ray

    def _parallel_ray(
        self, index: mi.UInt32, emitter: mi.EmitterPtr, square: mi.Point2f, u: mi.Float, v: mi.Float
    ) -> EmittedRay:
        """Sample rays from infinitely far: a direction, and a place on the disk."""
        active = self._is(index, DIRECTIONAL, ENVIRONMENT)
        it = dr.zeros(mi.Interaction3f)
        it.p = self.center
        ds, weight = emitter.sample_direction(it, square, active)
        active &= (ds.pdf > 0) & (dr.max(weight) > 0)
        disk = mi.warp.square_to_uniform_disk_concentric(mi.Point2f(u, v))
        place = mi.Frame3f(ds.d).to_world(mi.Vector3f(disk.x, disk.y, 1.0))
        area = dr.pi * dr.square(self.radius)
        return EmittedRay(
            o=mi.Point3f(self.center + self.radius * place),
            d=-ds.d,
            beta=dr.select(active, weight * area * self.count, 0.0),
            d_vcm=dr.select(active, area, 0.0),
            d_vc=dr.select(active & self._is(index, ENVIRONMENT), area * self.count / ds.pdf, 0.0),
            medium=dr.zeros(mi.MediumPtr),
            parallel=active,
        )

    def refuse_dark(self) -> None:
        """Raise a RenderError where no ray of a sample of them carries light: all are off."""
        x, y, u, v = HashedStream(dr.arange(mi.UInt32, 64 * self.count)).event(mi.UInt32(0))
        pick = (dr.arange(mi.Float, 64 * self.count) + 0.5) / (64 * self.count)
        if not dr.any(dr.max(self.start(pick, mi.Point2f(x, y), u, v).beta) > 0):
            names = ", ".join(repr(emitter.id()) for emitter in self.scene.emitters()[:4])
            raise RenderError(
                f"every emitter of the scene ({names}) emits nothing: raise a radiance, intensity "
                "or power",
                field="emitter",
            )

    def _radiance(
        self, emitter: mi.EmitterPtr, point: mi.Bool, ps: mi.PositionSample3f, n: mi.Vector3f,
        d: mi.Vector3f,
    ) -> mi.Spectrum:  # fmt: skip
        """Return radiance (intensity, where it is a ``point``) from ``ps`` in direction ``d``."""
        si = dr.zeros(mi.SurfaceInteraction3f)
        si.p, si.n, si.uv, si.sh_frame = ps.p, mi.Normal3f(n), ps.uv, mi.Frame3f(n)
        si.wi = si.sh_frame.to_local(d)
        if not self._has(POINT, SPOT):
            return emitter.eval(si)
        surface = emitter.eval(si, ~point)
        there = dr.zeros(mi.Interaction3f)
        there.p = ps.p + d
        # At unit distance irradiance equals intensity.
        _, intensity = emitter.sample_direction(there, mi.Point2f(0.5), point)
        return dr.select(point, intensity, surface)

    def met(self, v: Vertex, d_vcm: mi.Float, active: mi.Bool) -> mi.Spectrum:
        """Return the MIS-weighted radiance of an emitter that a camera subpath runs into (s = 0).

        Georgiev 2012, eqs. 43 and 37; ``d_vcm`` is that of ``v``, or 0 where direct light cannot
        compete.
        """
        if not self._has(AREA, FIBER, MEASURED):
            return mi.Spectrum(0.0)
        si = surface_interaction(v)
        active = active & ~v.volume
        emitter = v.shape.emitter()
        hit = active & (emitter != None)  # noqa: E711 (a Dr.Jit pointer array)
        radiance = (self.only or emitter).eval(si, hit)
        number = dr.reinterpret_array(mi.UInt32, emitter)
        index = dr.gather(mi.UInt32, self.places, number, hit)
        position_pdf = dr.rcp(dr.gather(mi.Float, self.area, index))
        for number, textured in self.textured.items():
            # At unit distance along the normal, a density of directions is one per area.
            above = mi.DirectionSample3f(mi.PositionSample3f(si))
            above.d, above.dist = -mi.Vector3f(si.n), mi.Float(1.0)
            there = textured.pdf_direction(si, above, hit & (index == number))
            position_pdf = dr.select(index == number, there, position_pdf)
        position_pdf /= self.count
        ratio = position_pdf * (d_vcm + self._profile(index, si.wi) * v.d_vc)
        return dr.select(hit, v.beta * radiance / (1.0 + ratio), 0.0)

    def escaped(self, state: SubpathState, first: mi.Bool, active: mi.Bool) -> mi.Spectrum:
        """Return the MIS-weighted light from afar along rays that left the scene (s = 0).

        ``state`` has the optical depth since the last vertex; with the ``first`` edge nothing
        competes.
        """
        if not self._has(ENVIRONMENT):
            return mi.Spectrum(0.0)
        emitter = self.scene.environment()
        si = dr.zeros(mi.SurfaceInteraction3f)
        si.wi = -state.d
        radiance = emitter.eval(si, active)
        it = dr.zeros(mi.Interaction3f)
        it.p = self.center
        ds = dr.zeros(mi.DirectionSample3f)
        ds.d = state.d
        pdf = emitter.pdf_direction(it, ds, active) / self.count
        # As on arrival at a surface, but with neither distance nor cosine.
        least = dr.min(state.depth)
        relative = dr.exp(-(state.depth - least))
        forward = channel_mean(relative)
        sigma = dr.select(state.from_volume, state.sigma_from, mi.Spectrum(1.0))
        d_vcm = dr.minimum(state.d_vcm / (forward * dr.exp(-least)), RATIO_MAX)
        d_vc = dr.minimum(state.d_vc * channel_mean(sigma * relative) / forward, RATIO_MAX)
        ratio = pdf * (dr.select(first, 0.0, d_vcm) + d_vc / (dr.pi * dr.square(self.radius)))
        return dr.select(active, state.beta * relative / forward * radiance / (1.0 + ratio), 0.0)

    def direct(
        self, v: Vertex, sample: LightSample, scattered: tuple[mi.Spectrum, mi.Float, mi.Float],
        active: mi.Bool,
    ) -> mi.Spectrum:  # fmt: skip
        """Return the MIS-weighted direct light at camera vertex ``v`` (s = 1), from ``sample``.

        Georgiev 2012, eqs. 44, 45 and 37, with positions sampled per area.
        """
        value, pdf, reverse = scattered
        value = v.beta * value * sample.received
        active = active & (dr.max(value) > 0)
        depth, clear = optical_depth(self.scene, v, sample.end, active, self.nulls)
        transmittance = dr.exp(-depth)
        # Against a camera subpath that runs into the emitter, and light subpaths that reach v.
        facing = sample.cosine / sample.squared
        hit = dr.select(
            sample.delta | v.terminal, 0.0, pdf * facing * channel_mean(transmittance) / sample.pdf
        )
        light = density_at(v, sample.d, sample.emitted, transmittance, active) / sample.squared
        mis = 1.0 / (1.0 + hit + light * (v.d_vcm + v.d_vc * reverse))
        return dr.select(active & clear, value * transmittance * mis, 0.0)

    def seen_from(
        self, v: Vertex, pick: mi.Float, square: mi.Point2f, active: mi.Bool
    ) -> LightSample:
        """Choose an emitter, and a place on it or a direction to it."""
        index, emitter, parallel, point = self._picked(pick)
        ps, _ = emitter.sample_position(mi.Float(0.0), square, active & ~parallel)
        span = ps.p - v.p
        squared = dr.squared_norm(span)
        d = mi.Vector3f(span * dr.rsqrt(squared))
        aimed = point & (dr.squared_norm(ps.n) == 0)
        axis = mi.Vector3f(dr.select(aimed, mi.Normal3f(-d), ps.n))
        cosine = dr.select(point, 1.0, dr.maximum(-dr.dot(axis, d), 0.0))
        pdf = dr.select(point, 1.0, ps.pdf) / self.count
        radiance = self._radiance(emitter, point, ps, axis, -d)
        valid = active & (squared > 0) & (cosine > 0) & (pdf > 0)
        end = empty_vertex()
        end.p, end.n, end.shape = ps.p, mi.Normal3f(axis), mi.EmitterPtr(emitter).get_shape()
        # A point has no surface to step off: treat it like a vertex in a volume.
        end.volume = mi.Bool(point)
        sample = LightSample(
            end=end, d=d, received=dr.select(valid, radiance * cosine / (squared * pdf), 0.0),
            pdf=pdf, cosine=cosine, squared=squared,
            emitted=self._profile(index, mi.Frame3f(axis).to_local(-d)), delta=mi.Bool(point),
        )  # fmt: skip
        if not self._has(DIRECTIONAL, ENVIRONMENT):
            return sample
        it = dr.zeros(mi.Interaction3f)
        it.p = v.p
        ds, weight = emitter.sample_direction(it, square, active & parallel)
        far = empty_vertex()
        far.p, far.volume = mi.Point3f(v.p + 2.0 * self.radius * ds.d), mi.Bool(True)
        one = mi.Float(1.0)
        afar = LightSample(
            end=far, d=mi.Vector3f(ds.d), received=weight * self.count, pdf=ds.pdf / self.count,
            cosine=one, squared=one, emitted=1.0 / (dr.pi * dr.square(self.radius)),
            delta=self._is(index, DIRECTIONAL),
        )  # fmt: skip
        return dr.select(parallel, afar, sample)


def _has_medium(part: mi.Shape | mi.Endpoint | None) -> bool:
    """Return whether light may be in a medium at a shape, an emitter or a camera."""
    if isinstance(part, mi.Shape):
        if class_of(part) == "Instance":  # its group is not shown
            return True
        return part.interior_medium() is not None or part.exterior_medium() is not None
    return part is not None and part.get_medium() is not None


def _may_be_null(shape: mi.Shape) -> bool:
    """Return whether light may pass a shape unchanged (``render.paths.vertex.is_null``)."""
    # What is in a group is not shown.
    return class_of(shape) == "Instance" or (
        shape.bsdf() is not None and mi.has_flag(shape.bsdf().flags(), mi.BSDFFlags.Null)
    )


def shape_corners(shape: mi.Shape) -> Array:
    """Return the lowest and the highest corner of the bounding box of ``shape``, ``(2, xyz)``.

    The boxes of meshes that Mitsuba's loader has merged are invalid.
    """
    box = shape.bbox()
    if box.valid():
        return np.array([box.min, box.max], dtype=np.float64).reshape(2, 3)
    points = np.array(mi.traverse(shape)["vertex_positions"], dtype=np.float64).reshape(-1, 3)
    return np.array([points.min(axis=0), points.max(axis=0)])


def bounding_sphere(scene: mi.Scene) -> tuple[Array, float]:
    """Return center and radius of a sphere around all shapes."""
    corners = [shape_corners(shape) for shape in scene.shapes()]
    if not corners:
        return np.zeros(3), 1.0
    around = np.concatenate(corners)
    low, high = around.min(axis=0), around.max(axis=0)
    return 0.5 * (low + high), max(0.5 * float(np.linalg.norm(high - low)), 1e-6)


def _area(emitter: mi.Emitter, kind: int) -> float:
    """Return the area of an emitting surface; 1 for other emitters."""
    if kind not in (AREA, FIBER, MEASURED):
        return 1.0
    area: float = dr.slice(emitter.get_shape().surface_area())
    return area


def _versine(emitter: mi.Emitter, kind: int) -> float:
    """Return 1 - cosine of the half angle of the cone that a point shines into."""
    if kind != SPOT:
        return 2.0
    degrees: float = dr.slice(mi.traverse(emitter)["cutoff_angle"])
    return float(2.0 * np.sin(0.5 * np.radians(degrees)) ** 2)
