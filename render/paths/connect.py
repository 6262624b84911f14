"""Connecting path vertices: ray casts and optical depths through null boundaries, and connections.

Only the choice of vertices is random here; nothing is scattered on the way between them. Equation
numbers are those of Georgiev 2012, "Implementing vertex connection and merging".
"""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr
import mitsuba as mi

from render.paths.reflection_lobe import ReflectionLobe
from render.paths.vertex import (
    Vertex,
    area_factor,
    channel_mean,
    empty_vertex,
    evaluate_scattering,
    extinction,
    has_wide_lobe,
    is_null,
    leave,
)
from render.paths.walk import GuidingDistribution, guided_pdf, intersect


@dr.syntax
def trace_to_surface(
    scene: mi.Scene, a: Vertex, direction: mi.Vector3f, active: mi.Bool
) -> tuple[Vertex, mi.Spectrum, mi.Bool]:
    """Return the first real surface from ``a`` in ``direction`` and the optical depth to it.

    The third value says whether there is one. Nothing is scattered on the way.
    """
    origin, medium = leave(a, direction)  # where the ray goes on, and through what
    depth = mi.Spectrum(0.0)  # optical depth so far
    surface = empty_vertex()  # the vertex where the ray arrived
    hit = mi.Bool(False)  # whether it has
    going = mi.Bool(active)  # lanes whose ray is under way
    while going:
        si = intersect(scene, mi.Ray3f(origin, direction), going)
        sigma_t = extinction(medium, going)[1]
        valid = going & si.is_valid()
        depth += dr.select(valid, sigma_t * si.t, 0.0)
        bsdf = si.bsdf()
        flags = bsdf.flags()
        crossing = valid & is_null(flags)
        arrived = valid & ~crossing
        here = Vertex(
            p=si.p, n=si.n, frame=si.sh_frame, wi=mi.Vector3f(-direction), uv=si.uv, bsdf=bsdf,
            shape=si.shape, medium=medium, phase=dr.zeros(mi.PhaseFunctionPtr),
            volume=mi.Bool(False), diffuse=mi.has_flag(flags, mi.BSDFFlags.Diffuse),
            delta=~mi.has_flag(flags, mi.BSDFFlags.Smooth), terminal=mi.Bool(False),
            beta=mi.Spectrum(0), d_vcm=mi.Float(0), d_vc=mi.Float(0), weight=mi.Float(1),
        )  # fmt: skip
        surface = dr.select(arrived, here, surface)
        hit |= arrived
        origin = dr.select(crossing, si.spawn_ray(direction).o, origin)
        medium = dr.select(
            crossing & si.is_medium_transition(), si.target_medium(direction), medium
        )
        going = crossing
    return surface, depth, hit


def optical_depth(
    scene: mi.Scene, a: Vertex, b: Vertex, active: mi.Bool, nulls: bool = True
) -> tuple[mi.Spectrum, mi.Bool]:
    """Return the optical depth per channel between two vertices and whether they see each other.

    Without ``nulls``, null boundaries, in the scene the whole way is through one medium.
    """
    between = b.p - a.p
    origin, medium = leave(a, between)
    # Both ends are off their surfaces: a ray that is shorter, or parallel to the line between the
    # vertices instead, misses walls close to them.
    span = leave(b, -between)[0] - origin
    distance = dr.norm(span)
    ray = mi.Ray3f(mi.Ray3f(origin, span / dr.maximum(distance, 1e-30)), distance)
    if nulls:
        return _across_nulls(scene, ray, medium, active)
    clear = active & ~scene.ray_test(ray, coherent=False, active=active)
    return extinction(medium, active)[1] * distance, clear


@dr.syntax
def _across_nulls(
    scene: mi.Scene, ray: mi.Ray3f, medium: mi.MediumPtr, active: mi.Bool
) -> tuple[mi.Spectrum, mi.Bool]:
    """Return what ``optical_depth`` does along ``ray``, which begins in ``medium``."""
    origin, direction = mi.Point3f(ray.o), ray.d  # where the ray goes on
    remaining = mi.Float(ray.maxt)  # distance to the end
    depth = mi.Spectrum(0.0)  # optical depth so far
    clear = mi.Bool(active)  # whether no real surface was in the way so far
    going = mi.Bool(active)  # lanes whose ray is under way
    while going:
        si = intersect(scene, mi.Ray3f(mi.Ray3f(origin, direction), remaining), going)
        t = dr.minimum(si.t, remaining)
        sigma_t = extinction(medium, going)[1]
        depth += sigma_t * t
        hit = going & si.is_valid()
        crossing = hit & is_null(si.bsdf().flags())
        clear &= ~hit | crossing
        beyond = si.spawn_ray(direction)
        step = dr.norm(beyond.o - origin)
        origin = dr.select(crossing, beyond.o, origin)
        medium = dr.select(
            crossing & si.is_medium_transition(), si.target_medium(direction), medium
        )
        remaining = dr.select(crossing, remaining - step, remaining)
        going = crossing & (remaining > 0)
    return depth, clear


def connect_vertices(
    scene: mi.Scene,
    y: Vertex,
    z: Vertex,
    active: mi.Bool,
    guiding: GuidingDistribution | None = None,
    extra: mi.Float | float = 0.0,
    glossy: float = 1.0,
    returning: GuidingDistribution | None = None,
) -> mi.Spectrum:
    """Return the MIS-weighted contribution of connecting light vertex ``y`` to camera vertex ``z``.

    Balance heuristic over all strategies (Veach 1997, eq. 10.9) from the recursive sums.
    ``extra`` is the density ratio of a further strategy to this one. ``glossy`` is what a
    connection counts between a glossy ``z`` and a ``y`` in a volume or on a diffuse surface.
    ``guiding`` is what camera subpaths mix at ``z``, ``returning`` what they mix at ``y``, where
    the recursive sums of ``y`` do not have it already.
    """
    active = active & (y.weight > 0) & (z.weight > 0)
    depth, clear = optical_depth(scene, y, z, active)
    light = connection_contribution(
        y, z, dr.exp(-depth), active & clear, guiding, extra, glossy, returning
    )
    return light * y.weight * z.weight


def connection_contribution(
    y: Vertex,
    z: Vertex,
    transmittance: mi.Spectrum,
    active: mi.Bool,
    guiding: GuidingDistribution | None = None,
    extra: mi.Float | float = 0.0,
    glossy: float = 1.0,
    returning: GuidingDistribution | None = None,
    lens: tuple[mi.Bool, float] | None = None,
) -> mi.Spectrum:
    """Return what ``connect_vertices`` does for a known transmittance between the vertices.

    ``lens`` says where ``z`` is on a lens, ``beta`` its importance, and what that strategy counts.
    """
    span = z.p - y.p
    distance_squared = dr.squared_norm(span)
    w = span * dr.rsqrt(distance_squared)
    active = active & (distance_squared > 0)
    f_y, p_y, r_y = evaluate_scattering(y, w, mi.TransportMode.Importance, active)
    f_z, p_z, r_z = evaluate_scattering(z, -w, mi.TransportMode.Radiance, active)
    p_z = guided_pdf(guiding, z, -w, p_z)
    if lens is not None:
        f_z = dr.select(lens[0], distance_squared, f_z)
        p_z = dr.select(lens[0], channel_mean(z.beta) * distance_squared, p_z)
    value = y.beta * f_y * f_z * z.beta / distance_squared
    camera_density = density_at(y, w, p_z, transmittance, active) / distance_squared
    light_density = density_at(z, w, p_y, transmittance, active) / distance_squared
    # Eqs. 40 and 41, the strategies before y and those behind z.
    light_ratio = camera_density * strategies_before(y, r_y, returning)
    light_ratio = dr.select(z.terminal, 0.0, light_ratio)
    camera_ratio = light_density * (z.d_vcm + z.d_vc * r_z)
    # Eq. 37, with a weight for this strategy.
    strategy = dr.select(has_wide_lobe(y) & ~has_wide_lobe(z), glossy, 1.0)
    strategy = strategy if lens is None else dr.select(lens[0], lens[1], strategy)
    mis = strategy / (strategy + light_ratio + camera_ratio + extra)
    return dr.select(active, value * transmittance * mis, 0.0)


def density_at(
    v: Vertex, w: mi.Vector3f, pdf: mi.Float, transmittance: mi.Spectrum, active: mi.Bool
) -> mi.Float:
    """Return the density with which a direction of ``pdf`` arrives at ``v`` along ``w``, at 1 mm.

    Times the cosine at a surface, and the mean over channels with which free paths of a
    transmittance reach ``v``: per length (1/mm) in a volume, a probability at a surface.
    """
    _, sigma_t = extinction(v.medium, active & v.volume)
    reach = dr.select(v.volume, channel_mean(sigma_t * transmittance), channel_mean(transmittance))
    return pdf * area_factor(v, w) * reach


def strategies_before(
    y: Vertex, reverse: mi.Float, returning: GuidingDistribution | None = None
) -> mi.Float:
    """Return what finds light vertex ``y`` and those before it otherwise (eq. 40).

    Over the density of arriving at ``y`` from the camera; ``reverse`` is that of scattering there
    towards its predecessor, ``returning`` what camera subpaths mix with it.
    """
    reverse = dr.select(y.terminal, 0.0, guided_pdf(returning, y, y.wi, reverse))
    return y.d_vcm + y.d_vc * reverse


def mirror_connection(
    scene: mi.Scene,
    y: Vertex,
    a: Vertex,
    lobe: ReflectionLobe,
    numbers: tuple[mi.Float, mi.Float],
    active: mi.Bool,
    probability: mi.Float | float = 1.0,
    in_mirror: Callable[[Vertex], mi.Bool] | None = None,
    guiding: GuidingDistribution | None = None,
    glossy: float = 1.0,
    returning: GuidingDistribution | None = None,
) -> mi.Spectrum:
    """Return the MIS-weighted light that camera vertex ``a`` gets from ``y`` over a glossy face.

    Two uniform ``numbers`` draw a direction of the ``lobe`` from ``a``, which is about the mirror
    image of ``y`` and was selected with ``probability``; it finds the vertex ``b`` on the face by
    itself. This is a further strategy of the balance heuristic (Veach 1997, sec. 9.2) for the paths

        ... - y (volume or diffuse) - b (glossy) - a (volume or diffuse) - ...

    ``in_mirror`` says whether ``b`` lies where the direction was meant to go; ``glossy`` is what
    connections of ``b`` to ``y`` count. Strategies that find ``b`` from either side compete.
    """
    direction = lobe.sample(*numbers)
    density = lobe.density(direction) * probability
    active = active & (y.weight > 0) & (a.weight > 0) & (density > 0)
    f_a, p_a, r_a = evaluate_scattering(a, direction, mi.TransportMode.Radiance, active)
    p_a = guided_pdf(guiding, a, direction, p_a)
    active = active & (dr.max(f_a) > 0)
    b, depth_ab, hit = trace_to_surface(scene, a, direction, active)
    active = hit & ~b.diffuse & ~b.delta
    if in_mirror is not None:
        active = active & in_mirror(b)
    span = b.p - y.p
    squared = dr.squared_norm(span)
    w = span * dr.rsqrt(squared)
    f_y, p_y, r_y = evaluate_scattering(y, w, mi.TransportMode.Importance, active)
    f_b, p_b, r_b = evaluate_scattering(b, -w, mi.TransportMode.Radiance, active)
    value = y.beta * f_y * f_b * f_a * a.beta / (squared * density)
    active = active & (dr.max(value) > 0) & (squared > 0)
    depth_by, clear = optical_depth(scene, y, b, active)
    t_ab, t_by = dr.exp(-depth_ab), dr.exp(-depth_by)
    distance_squared = dr.squared_norm(b.p - a.p)
    # The camera finds b from a; then light is connected to b, or the camera goes on to y (eq. 40).
    camera_b = dr.select(a.terminal, 0.0, p_a * channel_mean(t_ab) / density)
    camera_y = density_at(y, w, p_b, t_by, active) / squared
    camera_y *= strategies_before(y, r_y, returning)
    # Light finds b from y; then it is connected to a, or goes on to a (eq. 41).
    density_b = density * area_factor(b, direction) / distance_squared
    light_b = p_y * area_factor(b, w) * channel_mean(t_by) / squared / density_b
    light_a = density_at(a, direction, r_b, t_ab, active) / distance_squared
    light_a *= a.d_vcm + a.d_vc * r_a
    # Eq. 37.
    mis = 1.0 / (1.0 + camera_b * (glossy + camera_y) + light_b * (1.0 + light_a))
    return dr.select(clear & active, value * t_ab * t_by * mis * y.weight * a.weight, 0.0)
