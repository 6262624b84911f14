"""Connecting path vertices: ray casts and optical depths through null boundaries, and joins.

Only the choice of vertices is random here; nothing is scattered on the way between them.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from render.paths.vertex import (
    Vertex,
    area_factor,
    choose,
    empty_vertex,
    extinction,
    is_null,
    is_smooth,
    leave,
    scatter,
)
from render.paths.walk import Aim, intersect


@dr.syntax
def cast(scene: Any, a: Vertex, direction: Any, active: Any) -> tuple[Vertex, Any, Any]:
    """Return the first real surface from ``a`` in ``direction`` and the optical depth to it.

    The third value says whether there is one. Nothing is scattered on the way.
    """
    origin, medium = leave(a, direction)
    depth = mi.Spectrum(0.0)
    found = empty_vertex()
    hit = mi.Bool(False)
    going = mi.Bool(active)
    while going:
        si = intersect(scene, mi.Ray3f(origin, direction), going)
        sigma_t = extinction(medium, going)[1]
        valid = going & si.is_valid()
        depth += dr.select(valid, sigma_t * si.t, 0.0)
        crossing = valid & is_null(si)
        arrived = valid & ~crossing
        flags = si.bsdf().flags()
        here = Vertex(
            p=si.p, n=si.n, frame=si.sh_frame, wi=-direction, uv=si.uv, bsdf=si.bsdf(),
            shape=si.shape, medium=medium, phase=dr.zeros(mi.PhaseFunctionPtr),
            volume=mi.Bool(False), diffuse=mi.has_flag(flags, mi.BSDFFlags.Diffuse),
            delta=~mi.has_flag(flags, mi.BSDFFlags.Smooth), terminal=mi.Bool(False),
            beta=mi.Spectrum(0), vcm=mi.Float(0), vc=mi.Float(0), weight=mi.Float(1),
        )  # fmt: skip
        found = choose(arrived, here, found)
        hit |= arrived
        origin = dr.select(crossing, si.spawn_ray(direction).o, origin)
        medium = dr.select(
            crossing & si.is_medium_transition(), si.target_medium(direction), medium
        )
        going = crossing
    return found, depth, hit


@dr.syntax
def optical_depth(scene: Any, a: Vertex, b: Vertex, active: Any) -> tuple[Any, Any]:
    """Return the optical depth per channel between two vertices and whether they see each other."""
    between = b.p - a.p
    origin, medium = leave(a, between)
    # Both ends are off their surfaces: a ray that is shorter, or parallel to the line between the
    # vertices instead, misses walls close to them.
    span = leave(b, -between)[0] - origin
    remaining = dr.norm(span)
    direction = span / dr.maximum(remaining, 1e-30)
    depth = mi.Spectrum(0.0)
    clear = mi.Bool(active)
    going = mi.Bool(active)
    while going:
        si = intersect(scene, mi.Ray3f(mi.Ray3f(origin, direction), remaining), going)
        t = dr.minimum(si.t, remaining)
        sigma_t = extinction(medium, going)[1]
        depth += sigma_t * t
        hit = going & si.is_valid()
        crossing = hit & is_null(si)
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


def join(
    scene: Any,
    y: Vertex,
    z: Vertex,
    active: Any,
    aim: Aim | None = None,
    extra: Any = 0.0,
    bridged: Any = 0.0,
    glossy: float = 1.0,
) -> Any:
    """Return the MIS-weighted contribution of joining light vertex ``y`` to camera vertex ``z``.

    Balance heuristic over all strategies (Veach 1997, eq. 10.9) from the recursive sums.
    ``extra`` is the density ratio of a further strategy to this one; ``bridged`` that of a
    further strategy to the camera subpath that ends before ``z``. ``glossy`` is what a join counts
    between a glossy ``z`` and a ``y`` in a volume or on a diffuse surface.
    """
    active = active & (y.weight > 0) & (z.weight > 0)
    depth, clear = optical_depth(scene, y, z, active)
    joined = joined_through(y, z, dr.exp(-depth), active & clear, aim, extra, bridged, glossy)
    return joined * y.weight * z.weight


def joined_through(
    y: Vertex,
    z: Vertex,
    transmittance: Any,
    active: Any,
    aim: Aim | None = None,
    extra: Any = 0.0,
    bridged: Any = 0.0,
    glossy: float = 1.0,
) -> Any:
    """Return what ``join`` does for a known transmittance between the vertices."""
    span = z.p - y.p
    distance_squared = dr.squared_norm(span)
    w = span * dr.rsqrt(distance_squared)
    active = active & (distance_squared > 0)
    f_y, p_y, r_y = scatter(y, w, mi.TransportMode.Importance, active)
    f_z, p_z, r_z = scatter(z, -w, mi.TransportMode.Radiance, active)
    if aim is not None:
        p_z = dr.select(aim.guided(z), aim.mixed(z, -w, p_z), p_z)
    value = y.beta * f_y * f_z * z.beta / distance_squared
    _, sigma_y = extinction(y.medium, active & y.volume)
    _, sigma_z = extinction(z.medium, active & z.volume)
    mean_t = dr.mean(transmittance)
    reach_y = dr.select(y.volume, dr.mean(sigma_y * transmittance), mean_t)
    reach_z = dr.select(z.volume, dr.mean(sigma_z * transmittance), mean_t)
    camera_density = p_z * area_factor(y, w) * reach_y / distance_squared
    light_density = p_y * area_factor(z, w) * reach_z / distance_squared
    r_y = dr.select(y.terminal, 0.0, r_y)
    light_ratio = dr.select(z.terminal, 0.0, camera_density * (y.vcm + y.vc * r_y))
    camera_ratio = light_density * (z.vcm + z.vc * r_z)
    further = extra + light_density * z.vcm * bridged
    fair = dr.select(is_smooth(y) & ~is_smooth(z), glossy, 1.0)
    mis = fair / (fair + light_ratio + camera_ratio + further)
    return dr.select(active, value * transmittance * mis, 0.0)
