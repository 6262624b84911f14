"""Path vertices on surfaces and in media, and how light scatters at them.

The vocabulary of bidirectional path tracing (Veach 1997, ch. 10) with media as vertices of their
own (Lafortune and Willems 1996). A surface vertex evaluates its BSDF times the cosine of the
outgoing direction; a volume vertex its phase function. Densities are per solid angle.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import mitsuba as mi

RATIO_MAX = 1e30
"""MIS quantities are ratios of densities; beyond this they only mean "this strategy never"."""
VOLUME_PASSES = 2
"""Volume vertices that camera subpaths pass, at most, before they are absorbed at the next one."""


@dataclass
class Vertex:
    """One vertex of a light or camera subpath (a Dr.Jit PyTree, one lane per path).

    ``wi`` points back to the predecessor (world), ``n`` is the geometric normal, ``medium`` the
    medium through which the path arrived. ``beta`` is the throughput up to and including the
    arrival. ``d_vcm`` and ``d_vc`` are the recursive MIS sums of Georgiev 2012 ("Implementing
    vertex connection and merging", eqs. 31 to 39, without merging). ``weight`` is 1 / probability
    that this vertex was kept; 0 where there is none.
    """

    p: mi.Point3f
    n: mi.Normal3f
    frame: mi.Frame3f
    wi: mi.Vector3f
    uv: mi.Point2f
    bsdf: mi.BSDFPtr
    shape: mi.ShapePtr
    medium: mi.MediumPtr
    phase: mi.PhaseFunctionPtr
    volume: mi.Bool
    diffuse: mi.Bool
    delta: mi.Bool
    terminal: mi.Bool
    beta: mi.Spectrum
    d_vcm: mi.Float
    d_vc: mi.Float
    weight: mi.Float


@dataclass
class PassableVertex(Vertex):
    """A light vertex whose sums also come for camera subpaths that pass volumes.

    ``d_vc`` is for those that pass none, ``d_vc_passing[i]`` for those that pass up to ``i + 1``
    vertices in volumes, the vertices on this side of it (see ``passes_behind``).
    """

    d_vc_passing: mi.Vector2f

    @staticmethod
    def of(v: Vertex) -> PassableVertex:
        """Return ``v`` with the same sum for all camera subpaths."""
        return PassableVertex(**vars(v), d_vc_passing=mi.Vector2f(v.d_vc))


def channel_mean(value: mi.Spectrum) -> mi.Float:
    """Return the mean over channels.

    That of Dr.Jit (1.5) has the number of lanes in its code, so that every number of them is
    compiled anew.
    """
    return dr.sum(value) / len(value)


def empty_vertex() -> Vertex:
    """Return a vertex with weight 0, for loops that have not found one yet."""
    return Vertex(
        p=dr.zeros(mi.Point3f),
        n=dr.zeros(mi.Normal3f),
        frame=mi.Frame3f(mi.Vector3f(1, 0, 0), mi.Vector3f(0, 1, 0), mi.Vector3f(0, 0, 1)),
        wi=mi.Vector3f(0, 0, 1),
        uv=dr.zeros(mi.Point2f),
        bsdf=dr.zeros(mi.BSDFPtr),
        shape=dr.zeros(mi.ShapePtr),
        medium=dr.zeros(mi.MediumPtr),
        phase=dr.zeros(mi.PhaseFunctionPtr),
        volume=mi.Bool(False),
        diffuse=mi.Bool(False),
        delta=mi.Bool(False),
        terminal=mi.Bool(False),
        beta=mi.Spectrum(0.0),
        d_vcm=mi.Float(0.0),
        d_vc=mi.Float(0.0),
        weight=mi.Float(0.0),
    )


def has_wide_lobe(v: Vertex) -> mi.Bool:
    """Return whether ``v`` scatters widely: in a volume, or at a diffuse surface."""
    return v.volume | v.diffuse


def passes_behind(v: Vertex, passes: mi.UInt32) -> mi.UInt32:
    """Return how many volume vertices a camera subpath may still pass behind ``v``.

    ``passes`` is their number before it. Behind a diffuse surface it is none.
    """
    fewer = dr.maximum(passes, 1) - 1
    return dr.select(v.diffuse, 0, dr.select(v.volume, fewer, passes))


def d_vc_for(v: PassableVertex, passes: mi.UInt32) -> mi.Float:
    """Return ``d_vc`` of ``v`` for camera subpaths that pass so many volume vertices behind it."""
    d_vc = v.d_vc
    for i in range(VOLUME_PASSES):
        d_vc = dr.select(passes == i + 1, v.d_vc_passing[i], d_vc)
    return d_vc


def for_camera_passes(y: PassableVertex, passes: mi.UInt32) -> Vertex:
    """Return ``y`` with its sums for camera subpaths that may still pass so many volumes."""
    chosen = replace(y)
    chosen.terminal = y.terminal & (passes == 0)
    chosen.d_vc = d_vc_for(y, passes_behind(y, passes))
    return chosen


@dataclass(frozen=True)
class EitherMode:
    """The mode of transport of subpaths of both kinds, lane by lane.

    Without refraction both scatter alike (``refracts``), but for shading normals.
    """

    importance: mi.Bool
    refracts: bool


def by_mode(
    mode: mi.TransportMode | EitherMode, bsdfs: mi.BSDFPtr, active: mi.Bool,
    scatter: Callable[..., Any], *arguments: Any,
) -> Any:  # fmt: skip
    """Return what ``scatter`` does with each BSDF in a mode, for ``active`` lanes.

    It may ask several things of a BSDF: every call of one is compiled by itself.
    """

    def scattered(kind: mi.TransportMode, on: mi.Bool) -> Any:
        context = mi.BSDFContext(kind)
        return dr.dispatch(
            bsdfs, lambda bsdf, on, *given: scatter(bsdf, context, on, *given), on, *arguments
        )

    if not isinstance(mode, EitherMode):
        return scattered(mode, active)
    radiance = mi.TransportMode.Radiance
    if not mode.refracts:
        return scattered(radiance, active)
    return dr.select(
        mode.importance,
        scattered(mi.TransportMode.Importance, active & mode.importance),
        scattered(radiance, active & ~mode.importance),
    )


def reverse_pdf(
    bsdf: mi.BSDF, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool
) -> mi.Float:
    """Return the density with which light from local ``wo`` is scattered to ``si.wi``."""
    reverse = mi.SurfaceInteraction3f(si)
    reverse.wi = wo
    return bsdf.pdf(mi.BSDFContext(), reverse, si.wi, active)


def surface_interaction(v: Vertex) -> mi.SurfaceInteraction3f:
    """Return the Mitsuba surface interaction that ``v`` stands for."""
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.p, si.n, si.sh_frame, si.uv, si.shape = v.p, v.n, v.frame, v.uv, v.shape
    si.wi = v.frame.to_local(v.wi)
    return si


def medium_interaction(v: Vertex) -> mi.MediumInteraction3f:
    """Return the Mitsuba medium interaction that ``v`` stands for."""
    mei = dr.zeros(mi.MediumInteraction3f)
    mei.p, mei.wi, mei.medium = v.p, v.wi, v.medium
    mei.sh_frame = mi.Frame3f(v.wi)
    return mei


def evaluate_scattering(
    v: Vertex, wo: mi.Vector3f, mode: mi.TransportMode | EitherMode, active: mi.Bool
) -> tuple[mi.Spectrum, mi.Float, mi.Float]:
    """Return value, density of ``wo`` and density of the reverse, at ``v`` for a given ``wo``.

    ``wo`` is a world direction away from the vertex, ``mode`` that of the subpath that the vertex
    belongs to. The value of a surface includes the cosine of ``wo``. Phase functions are taken to
    be symmetric, which all of Mitsuba's are.
    """
    surface, volume = active & ~v.volume, active & v.volume
    si = surface_interaction(v)
    local = v.frame.to_local(wo)

    def evaluated(
        bsdf: mi.BSDF, context: mi.BSDFContext, on: mi.Bool, si: mi.SurfaceInteraction3f,
        wo: mi.Vector3f,
    ) -> tuple[mi.Spectrum, mi.Float, mi.Float]:  # fmt: skip
        return *bsdf.eval_pdf(context, si, wo, on), reverse_pdf(bsdf, si, wo, on)

    value, pdf, reverse = by_mode(mode, v.bsdf, surface, evaluated, si, local)
    phase, phase_pdf = v.phase.eval_pdf(
        mi.PhaseFunctionContext(), medium_interaction(v), wo, volume
    )
    value = dr.select(v.volume, phase, value * shading_factor(v, wo, mode))
    pdf = dr.select(v.volume, phase_pdf, pdf)
    reverse = dr.select(v.volume, phase_pdf, reverse)
    return value, pdf, reverse


def shading_factor(
    v: Vertex, wo: mi.Vector3f, mode: mi.TransportMode | EitherMode
) -> mi.Float | float:
    """Return what a shading normal takes from or adds to light that ``v`` sends to ``wo``.

    A mesh with normals of its vertices scatters importance otherwise than radiance (Veach 1997,
    eq. 5.19); 1 where the shading normal is the surface's own.
    """
    if not isinstance(mode, EitherMode) and mode != mi.TransportMode.Importance:
        return 1.0
    sent = dr.abs(dr.dot(v.frame.n, v.wi) * dr.dot(v.n, wo))
    received = dr.abs(dr.dot(v.n, v.wi) * dr.dot(v.frame.n, wo))
    factor = dr.select(received > 0, sent / received, 0.0)
    return dr.select(mode.importance, factor, 1.0) if isinstance(mode, EitherMode) else factor


def scattering_value(
    v: Vertex, wo: mi.Vector3f, mode: mi.TransportMode, active: mi.Bool
) -> mi.Spectrum:
    """Return the first result of ``evaluate_scattering`` alone."""
    si = surface_interaction(v)
    local = v.frame.to_local(wo)
    surface = v.bsdf.eval(mi.BSDFContext(mode), si, local, active & ~v.volume)
    phase, _ = v.phase.eval_pdf(
        mi.PhaseFunctionContext(), medium_interaction(v), wo, active & v.volume
    )
    return dr.select(v.volume, phase, surface * shading_factor(v, wo, mode))


def area_factor(v: Vertex, direction: mi.Vector3f) -> mi.Float:
    """Return the cosine that turns a density per solid angle into one per area; 1 in a volume."""
    return dr.select(v.volume, 1.0, dr.abs(dr.dot(v.frame.n, direction)))


def leave(v: Vertex, direction: mi.Vector3f) -> tuple[mi.Point3f, mi.MediumPtr]:
    """Return origin and medium of a ray that leaves ``v`` in ``direction``, off the surface."""
    outside = dr.dot(v.n, direction) > 0
    magnitude = (1.0 + dr.max(dr.abs(v.p))) * mi.math.RayEpsilon
    offset = dr.select(v.volume, 0.0, dr.select(outside, magnitude, -magnitude))
    transition = ~v.volume & v.shape.is_medium_transition()
    beyond = dr.select(outside, v.shape.exterior_medium(), v.shape.interior_medium())
    return v.p + offset * mi.Vector3f(v.n), dr.select(transition, beyond, v.medium)


def extinction(medium: mi.MediumPtr, active: mi.Bool) -> tuple[mi.Spectrum, mi.Spectrum]:
    """Return ``(sigma_s, sigma_t)`` of homogeneous media in 1/mm; 0 outside of any medium."""
    inside = active & (medium != None)  # noqa: E711 (a Dr.Jit pointer array)
    sigma_s, _, sigma_t = medium.get_scattering_coefficients(
        dr.zeros(mi.MediumInteraction3f), inside
    )
    return dr.select(inside, sigma_s, 0.0), dr.select(inside, sigma_t, 0.0)


def is_null(flags: mi.UInt32) -> mi.Bool:
    """Return whether such a BSDF is an index-matched boundary that light passes unchanged."""
    # A thin pane of glass passes light unchanged too, but reflects some of it.
    reflects = mi.has_flag(flags, mi.BSDFFlags.DeltaReflection)
    non_delta = mi.has_flag(flags, mi.BSDFFlags.Smooth)
    return mi.has_flag(flags, mi.BSDFFlags.Null) & ~non_delta & ~reflects
