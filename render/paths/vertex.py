"""Path vertices on surfaces and in media, and how light scatters at them.

The vocabulary of bidirectional path tracing (Veach 1997, ch. 10) with media as vertices of their
own (Lafortune and Willems 1996). A surface vertex evaluates its BSDF times the cosine of the
outgoing direction; a volume vertex its phase function. Densities are per solid angle.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeVar

import drjit as dr
import mitsuba as mi

# MIS quantities are ratios of densities; beyond this they only mean "this strategy never".
RATIO_MAX = 1e30


@dataclass
class Vertex:
    """One vertex of a light or camera subpath (a Dr.Jit PyTree, one lane per path).

    ``wi`` points back to the predecessor (world), ``n`` is the geometric normal, ``medium`` the
    medium through which the path arrived. ``beta`` is the throughput up to and including the
    arrival. ``vcm`` and ``vc`` are the recursive MIS sums of Georgiev 2012 (without merging).
    ``weight`` is 1 / probability that this vertex was kept; 0 where there is none.
    """

    p: Any
    n: Any
    frame: Any
    wi: Any
    uv: Any
    bsdf: Any
    shape: Any
    medium: Any
    phase: Any
    volume: Any
    diffuse: Any
    delta: Any
    terminal: Any
    beta: Any
    vcm: Any
    vc: Any
    weight: Any


@dataclass
class OpenVertex(Vertex):
    """A light vertex whose sums also come for camera subpaths that pass volumes.

    ``vc`` is for those that pass none, ``vc_open[i]`` for those that pass up to ``i + 1`` vertices
    in volumes, the vertices on this side of it (see ``left_after``).
    """

    vc_open: Any


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
        vcm=mi.Float(0.0),
        vc=mi.Float(0.0),
        weight=mi.Float(0.0),
    )


PASSES = 2
"""Volume vertices that camera subpaths pass, at most, before they are absorbed at the next one.

``OpenVertex.vc_open``, a ``Vector2f``, has a sum for each.
"""


def left_after(v: Vertex, left: Any) -> Any:
    """Return how many volume vertices a camera subpath may still pass behind ``v``.

    ``left`` is their number before it. Behind a diffuse surface it is none.
    """
    fewer = dr.maximum(left, 1) - 1
    return dr.select(v.diffuse, 0, dr.select(v.volume, fewer, left))


def vc_of(v: OpenVertex, left: Any) -> Any:
    """Return the sum of ``v`` for camera subpaths that pass ``left`` volume vertices behind it."""
    vc = v.vc
    for i in range(PASSES):
        vc = dr.select(left == i + 1, v.vc_open[i], vc)
    return vc


_V = TypeVar("_V", bound="Vertex")


def choose(condition: Any, a: _V, b: _V) -> _V:
    """Return ``a`` where ``condition`` holds, else ``b``."""
    chosen = {k: dr.select(condition, getattr(a, k), getattr(b, k)) for k in vars(b)}
    return type(b)(**chosen)


def is_smooth(v: Vertex) -> Any:
    """Return whether ``v`` scatters widely: in a volume, or at a diffuse surface."""
    return v.volume | v.diffuse


def surface_interaction(v: Vertex) -> Any:
    """Return the Mitsuba surface interaction that ``v`` stands for."""
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.p, si.n, si.sh_frame, si.uv, si.shape = v.p, v.n, v.frame, v.uv, v.shape
    si.wi = v.frame.to_local(v.wi)
    return si


def medium_interaction(v: Vertex) -> Any:
    """Return the Mitsuba medium interaction that ``v`` stands for."""
    mei = dr.zeros(mi.MediumInteraction3f)
    mei.p, mei.wi, mei.medium = v.p, v.wi, v.medium
    mei.sh_frame = mi.Frame3f(v.wi)
    return mei


def scatter(v: Vertex, wo: Any, mode: Any, active: Any) -> tuple[Any, Any, Any]:
    """Return value, density of ``wo`` and density of the reverse, at ``v`` for a given ``wo``.

    ``wo`` is a world direction away from the vertex, ``mode`` the ``mi.TransportMode`` of the
    subpath that the vertex belongs to. The value of a surface includes the cosine of ``wo``.
    Phase functions are taken to be symmetric, which all of Mitsuba's are.
    """
    surface, volume = active & ~v.volume, active & v.volume
    si = surface_interaction(v)
    context = mi.BSDFContext(mode)
    local = v.frame.to_local(wo)
    value, pdf = v.bsdf.eval_pdf(context, si, local, surface)
    back = mi.Vector3f(si.wi)
    si.wi = local
    reverse = v.bsdf.pdf(context, si, back, surface)
    phase, phase_pdf = v.phase.eval_pdf(
        mi.PhaseFunctionContext(), medium_interaction(v), wo, volume
    )
    value = dr.select(v.volume, phase, value)
    pdf = dr.select(v.volume, phase_pdf, pdf)
    reverse = dr.select(v.volume, phase_pdf, reverse)
    return value, pdf, reverse


def value(v: Vertex, wo: Any, mode: Any, active: Any) -> Any:
    """Return the first result of ``scatter`` alone."""
    si = surface_interaction(v)
    local = v.frame.to_local(wo)
    surface = v.bsdf.eval(mi.BSDFContext(mode), si, local, active & ~v.volume)
    phase, _ = v.phase.eval_pdf(
        mi.PhaseFunctionContext(), medium_interaction(v), wo, active & v.volume
    )
    return dr.select(v.volume, phase, surface)


def area_factor(v: Vertex, direction: Any) -> Any:
    """Return the cosine that turns a density per solid angle into one per area; 1 in a volume."""
    return dr.select(v.volume, 1.0, dr.abs(dr.dot(v.frame.n, direction)))


def leave(v: Vertex, direction: Any) -> tuple[Any, Any]:
    """Return origin and medium of a ray that leaves ``v`` in ``direction``, off the surface."""
    outside = dr.dot(v.n, direction) > 0
    magnitude = (1.0 + dr.max(dr.abs(v.p))) * mi.math.RayEpsilon
    offset = dr.select(v.volume, 0.0, dr.select(outside, magnitude, -magnitude))
    transition = ~v.volume & v.shape.is_medium_transition()
    beyond = dr.select(outside, v.shape.exterior_medium(), v.shape.interior_medium())
    return v.p + offset * mi.Vector3f(v.n), dr.select(transition, beyond, v.medium)


def extinction(medium: Any, active: Any) -> tuple[Any, Any]:
    """Return ``(sigma_s, sigma_t)`` of homogeneous media in 1/mm; 0 outside of any medium."""
    inside = active & (medium != None)  # noqa: E711 (a Dr.Jit pointer array)
    sigma_s, _, sigma_t = medium.get_scattering_coefficients(
        dr.zeros(mi.MediumInteraction3f), inside
    )
    return dr.select(inside, sigma_s, 0.0), dr.select(inside, sigma_t, 0.0)


def is_null(si: Any) -> Any:
    """Return whether a surface is an index-matched boundary that light passes unchanged."""
    flags = si.bsdf().flags()
    # A thin pane of glass passes light unchanged too, but reflects some of it.
    reflects = mi.has_flag(flags, mi.BSDFFlags.DeltaReflection)
    smooth = mi.has_flag(flags, mi.BSDFFlags.Smooth)
    return mi.has_flag(flags, mi.BSDFFlags.Null) & ~smooth & ~reflects
