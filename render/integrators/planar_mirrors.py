"""Flat glossy faces of any scene, as mirrors of mirror connections.

Triangles of glossy meshes, rectangles and disks are gathered into planes by normal and offset.
The largest planes are kept; a curved mesh spreads over many small ones and gives none.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from render.arrays import Array

MIRRORS_MAX = 8
"""Planes that are kept, by area."""
AREA_FRACTION_MIN = 0.02
"""Planes below this fraction of all glossy area are not worth a connection."""
PLANE_TOLERANCE = 1e-4
"""Normals and offsets (relative to the size of all of them) closer than this are one plane's."""
COSINE_BINS = 16
"""Equal steps of the cosine in which the reflectance of a face is known."""
REFLECTANCE_MIN = 0.01
"""Least reflectance, so that no side of a face is taken to be black."""
PROBE_COUNT = 2048
"""Directions and random numbers with which the roughness of a face is measured."""


@dataclass(frozen=True)
class PlanarMirror:
    """A plane ``normal . p = offset``, the box around its faces (mm), and how it reflects.

    ``slope`` is the standard deviation of the microfacets' slopes per axis; ``area`` in mm^2.
    ``reflectance`` ``(2, COSINE_BINS)`` by cosine, behind the plane and on the side of its normal.
    """

    normal: Array
    offset: float
    low: Array
    high: Array
    area: float
    slope: float
    reflectance: Array


def find_mirrors(scene: mi.Scene) -> list[PlanarMirror]:
    """Return the flat glossy faces of a Mitsuba scene, the largest first."""
    parts, slopes, reflectances = [], [], []
    for shape in scene.shapes():
        if shape.bsdf() is None or not _is_glossy(shape.bsdf()):
            continue
        triangles = _triangles(shape)
        if len(triangles):
            parts.append(triangles)
            slopes.append(np.full(len(triangles), measured_slope(shape.bsdf())))
            table = measured_reflectance(shape.bsdf())
            reflectances.append(np.repeat(table[None], len(triangles), axis=0))
    if not parts:
        return []
    return _planes(np.concatenate(parts), np.concatenate(slopes), np.concatenate(reflectances))


def _is_glossy(bsdf: mi.BSDF) -> bool:
    flags = bsdf.flags()
    return mi.has_flag(flags, mi.BSDFFlags.GlossyReflection) and not mi.has_flag(
        flags, mi.BSDFFlags.Diffuse
    )


def _triangles(shape: mi.Shape) -> Array:
    """Return ``(triangle, corner, xyz)`` of a shape that may be flat; none for other shapes."""
    parameters = mi.traverse(shape)
    if "vertex_positions" in parameters:
        points = np.array(parameters["vertex_positions"], dtype=np.float64).reshape(-1, 3)
        return np.asarray(points[np.array(parameters["faces"]).reshape(-1, 3)])
    if shape.class_name() in ("Rectangle", "Disk"):
        # A disk fills its square well enough to be aimed at.
        square = [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]
        to_world = np.array(parameters["to_world"].matrix, dtype=np.float64)
        matrix = to_world.reshape(4, 4)
        corners = np.array(square, dtype=np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
        return np.asarray(corners[[[0, 1, 2], [0, 2, 3]]])
    return np.zeros((0, 3, 3))


def _planes(triangles: Array, slopes: Array, reflectances: Array) -> list[PlanarMirror]:
    size = float(np.ptp(triangles.reshape(-1, 3), axis=0).max())
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    double = np.linalg.norm(cross, axis=1)
    solid = double > 0
    triangles, slopes, area = triangles[solid], slopes[solid], 0.5 * double[solid]
    reflectances = reflectances[solid]
    normal = cross[solid] / double[solid, None]
    # Both sides of a face are the same mirror: the first component that is not 0 is positive.
    leading = np.argmax(np.abs(normal) > PLANE_TOLERANCE, axis=1)
    sign = np.sign(np.take_along_axis(normal, leading[:, None], axis=1))
    normal = normal * sign
    reflectances = np.where(sign[:, None] > 0, reflectances, reflectances[:, ::-1])
    offset = np.einsum("ij,ij->i", normal, triangles[:, 0])
    remaining = np.ones(len(area), dtype=bool)
    mirrors: list[PlanarMirror] = []
    total = area.sum()
    order = np.argsort(-area, kind="stable")
    for i in order[: 64 * MIRRORS_MAX]:
        if not remaining[i]:
            continue
        same = remaining & (normal @ normal[i] > 1 - 0.5 * PLANE_TOLERANCE**2)
        same &= np.abs(offset - offset[i]) < PLANE_TOLERANCE * size
        remaining &= ~same
        corners = triangles[same].reshape(-1, 3)
        mirrors.append(
            PlanarMirror(
                normal[i],
                float(offset[i]),
                corners.min(axis=0),
                corners.max(axis=0),
                float(area[same].sum()),
                float(np.average(slopes[same], weights=area[same])),
                np.average(reflectances[same], axis=0, weights=area[same]),
            )
        )
    mirrors.sort(key=lambda mirror: -mirror.area)
    return [m for m in mirrors[:MIRRORS_MAX] if m.area > AREA_FRACTION_MIN * total]


def measured_slope(bsdf: mi.BSDF) -> float:
    """Return the standard deviation of the slopes of a glossy face, from its own samples.

    From the median of what it reflects at 45 degrees, either side; 0.1 where it reflects nothing.
    """
    side = np.where(np.arange(PROBE_COUNT) % 2 == 0, 1.0, -1.0)
    wi, wo, weight = _probed(bsdf, 0.5**0.5 * side)
    half = wo + wi
    half /= np.linalg.norm(half, axis=0)
    alive = (weight > 0) & (wo[2] * side > 0)
    if alive.sum() < 16:
        return 0.1
    squared = (half[0, alive] ** 2 + half[1, alive] ** 2) / half[2, alive] ** 2
    # Gaussian slopes: the squared length is exponential with mean 2 slope^2.
    return float(np.clip(np.sqrt(np.median(squared) / (2 * np.log(2))), 1e-3, 1.0))


def measured_reflectance(bsdf: mi.BSDF) -> Array:
    """Return the reflectance of a face, ``(2, COSINE_BINS)``, from its own samples.

    From behind and from the side of its normal, by the cosine; at least ``REFLECTANCE_MIN``.
    """
    cosine = np.repeat((np.arange(COSINE_BINS) + 0.5) / COSINE_BINS, PROBE_COUNT // COSINE_BINS)
    table = np.empty((2, COSINE_BINS))
    for side, sign in enumerate((-1.0, 1.0)):
        _, wo, weight = _probed(bsdf, sign * cosine)
        reflected = np.where(wo[2] * sign > 0, weight, 0.0)
        table[side] = reflected.reshape(COSINE_BINS, -1).mean(axis=1)
    return np.clip(table, REFLECTANCE_MIN, 1.0)


def _probed(bsdf: mi.BSDF, cosine: Array) -> tuple[Array, Array, Array]:
    """Return incident and sampled directions ``(xyz, probe)`` and weights at these cosines."""
    numbers = np.random.default_rng(1).random((3, PROBE_COUNT)).astype(np.float32)
    wi = np.stack([np.sqrt(1.0 - cosine**2), np.zeros(PROBE_COUNT), cosine])
    si = dr.zeros(mi.SurfaceInteraction3f, PROBE_COUNT)
    si.wi = mi.Vector3f(wi.astype(np.float32))
    si.n, si.sh_frame = mi.Normal3f(0, 0, 1), mi.Frame3f(mi.Vector3f(0, 0, 1))
    sample, weight = bsdf.sample(
        mi.BSDFContext(), si, mi.Float(numbers[0]), mi.Point2f(numbers[1:]), True
    )
    return wi, np.array(sample.wo, dtype=np.float64), np.array(dr.mean(weight), dtype=np.float64)
