"""Which vertex of a light subpath is joined to a camera subpath of the film sampler.

A light subpath scatters many times and every join costs several ray casts, so one vertex per
subpath is drawn in proportion to a *promise* and stands for all: resampled importance sampling
(Talbot et al. 2005) with a reservoir, as in ``render.resampling``, for scenes of which nothing is
known. The promise is what the vertex scatters towards one camera vertex, through the medium up to
the first surface on the way there: one ray cast. It is positive wherever a join can be, so its
errors cost time, not truth.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from render.film_bridge import Mirrors
from render.vertex import RATIO_MAX, Vertex, area_factor, extinction, leave, value

# Optical depths are cut here: the promise is never 0.
DEPTH_MAX = 4.0
# Added to the cosine at the camera vertex: other vertices face elsewhere.
TILT = 0.3
# Least that a vertex is taken to scatter, per solid angle and relative to what arrives there.
GLIMPSE = 0.08


def through(scene: Any, y: Vertex, a: Vertex, active: Any) -> Any:
    """Return the transmittance from ``y`` to the first surface towards ``a``, at least e^-4."""
    origin, medium = leave(y, a.p - y.p)
    span = a.p - origin
    distance = dr.norm(span)
    sigma = dr.mean(extinction(medium, active)[1])
    inside = active & (sigma > 0)
    ray = mi.Ray3f(mi.Ray3f(origin, span / dr.maximum(distance, 1e-20)), distance)
    found = scene.ray_intersect_preliminary(ray, coherent=False, active=inside)
    depth = sigma * dr.select(found.is_valid(), found.t, distance)
    return dr.exp(-dr.minimum(dr.select(inside, depth, 0.0), DEPTH_MAX))


def promise(y: Vertex, z: Vertex, active: Any) -> Any:
    """Return what ``y`` sends to camera vertex ``z`` in a vacuum; never 0 where active."""
    span = z.p - y.p
    distance = dr.norm(span)
    w = span / dr.maximum(distance, 1e-20)
    active = active & (z.weight > 0)
    scattered = value(y, w, mi.TransportMode.Importance, active)
    light = dr.mean(y.beta * scattered) + GLIMPSE * dr.mean(y.beta)
    facing = dr.select(z.volume, 1.0, dr.abs(dr.dot(z.n, w)) + TILT)
    # Poles and peaks of the join are where one subpath finds the other's vertex by itself: there
    # MIS takes them away.
    by_light = dr.mean(scattered) * _per_length(z, w) * z.vcm
    by_camera = facing * _per_length(y, w) * y.vcm
    near = dr.maximum(_apart(dr.square(distance), z), dr.square(distance) + by_light + by_camera)
    return dr.select(active, light * facing / dr.minimum(near, RATIO_MAX), 0.0)


def _per_length(v: Vertex, direction: Any) -> Any:
    """Return the cosine at ``v``, or the extinction (1/mm) in a volume."""
    sigma = dr.mean(extinction(v.medium, v.volume)[1])
    return dr.select(v.volume, sigma, area_factor(v, direction))


def mirrored(mirrors: Mirrors, y: Vertex, a: Vertex, active: Any) -> Any:
    """Return the light that ``y`` sends to ``a`` over the likeliest mirror, as ``promise`` does."""
    active = active & (a.weight > 0)
    image, liking = mirrors.likeliest(y.p, a.p)
    w = image - y.p
    squared = dr.squared_norm(w)
    w *= dr.rsqrt(dr.maximum(squared, 1e-20))
    light = dr.mean(y.beta * value(y, w, mi.TransportMode.Importance, active))
    light += GLIMPSE * dr.mean(y.beta)
    return dr.select(active & (liking > 0), light / _apart(squared, a), 0.0)


def _apart(squared: Any, z: Vertex) -> Any:
    # Joins inside a volume are not brighter than those half a mean free path apart.
    sigma = dr.mean(extinction(z.medium, z.volume)[1])
    near = dr.select(sigma > 0, 0.5 / sigma, 0.0)
    return dr.maximum(squared + dr.square(near), 1e-12)
