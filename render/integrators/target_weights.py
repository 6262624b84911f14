"""What a light vertex would send to a camera vertex: by which one of many is drawn for a join.

A *promise* is the contribution of a join as if only the medium up to the first surface were in the
way: one ray cast, where a join follows the light through null boundaries and a bridge casts two
rays. It is positive wherever the contribution can be, so its errors cost time, not truth:
resampled importance sampling (Talbot et al. 2005), as in ``render.cells.resampling``, for scenes of
which nothing is known.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import drjit as dr
import mitsuba as mi

from render.integrators.mirror_connections import Mirrors
from render.integrators.path_limits import GLOSSY
from render.paths.connect import joined_through
from render.paths.vertex import Vertex, extinction, leave, value

# Optical depths are cut here: the promise is never 0.
DEPTH_MAX = 4.0
# Added to what either end of a bridge scatters: its direction varies about the mirror image's.
FAINT = 0.02


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


def promise(scene: Any, y: Vertex, z: Vertex, active: Any) -> Any:
    """Return the MIS-weighted light that camera vertex ``z`` gets from ``y``, not hidden."""
    active = active & (z.weight > 0)
    clear = through(scene, y, z, active)
    return dr.mean(joined_through(y, z, mi.Spectrum(clear), active, glossy=GLOSSY)) * z.weight


def mirrored(
    scene: Any, mirrors: Mirrors, y: Vertex, a: Vertex, k: Any, chance: Any, active: Any
) -> Any:
    """Return the light that ``a`` gets from ``y`` over mirror ``k``, drawn with ``chance``.

    By a perfect mirror of the same reflectance, through the medium at ``y``.
    """
    active = active & (a.weight > 0) & (chance > 0)
    normal, image, liking = mirrors.image(k, a.p, y.p)
    w = image - y.p
    squared = dr.squared_norm(w)
    w *= dr.rsqrt(dr.maximum(squared, 1e-20))
    back = 2.0 * dr.dot(w, normal) * normal - w
    sent = value(y, w, mi.TransportMode.Importance, active) + FAINT
    received = value(a, back, mi.TransportMode.Radiance, active) + FAINT
    light = dr.mean(y.beta * sent * received) * liking * squared / _apart(squared, a)
    end = replace(a)
    end.p = image
    return dr.select(active, light * through(scene, y, end, active) / chance, 0.0)


def _apart(squared: Any, z: Vertex) -> Any:
    # Joins inside a volume are not brighter than those half a mean free path apart.
    sigma = dr.mean(extinction(z.medium, z.volume)[1])
    near = dr.select(sigma > 0, 0.5 / sigma, 0.0)
    return dr.maximum(squared + dr.square(near), 1e-12)
