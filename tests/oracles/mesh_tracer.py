"""Analog photons among triangles: pads at any bend, by the faces and lobes of ``analog_tracer``.

The pad is a closed surface of triangles of four kinds, in a uniform grid of cells that rays step
through (Amanatides and Woo 1987). Which of air, clear silicone and rim a ray is in follows from
the face that it met last and the side on which it left. Light that leaves a bent pad may enter it
again.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tests.oracles.analog_tracer import (
    BACK,
    COATING,
    ENDS,
    MAX_EVENTS,
    MEDIUM,
    MICROFACETS,
    OPEN,
    OUTSIDE,
    PAINTED,
    Floats,
    Lamp,
    compiled,
    emit,
    henyey_greenstein,
    lambertian,
    meet_face,
    meet_paint,
    uniform,
)

Integers = NDArray[np.int64]

COATED, OUTER_CLEAR, OUTER_RIM, INTERFACE, BOND, OUTER_WINDOW = range(6)
"""Kinds of faces; normals point into the clear silicone, the air, the air, the clear silicone, the
window and the air."""
AIR, CLEAR, RIM, WINDOW = range(4)
LEAKED = ENDS
"""Where power ends that found a gap between triangles: a part of 1e-6 at most."""


class MeshPad(NamedTuple):
    """What photons move in; lengths in mm, coefficients in 1/mm.

    Arguments:
        corner, first, second: ``(face, 3)`` a corner of each triangle and the edges from it.
        normal: ``(face, 3)`` unit normals.
        kind: ``(face,)``.
        low, cell: ``(3,)`` corner of the grid and size of its cells; ``shape`` how many.
        start, member: faces of cell ``c`` are ``member[start[c]:start[c + 1]]``.
        index: of the silicone; ``window`` that of the plate under it.
        alpha: ``(face,)`` Beckmann roughness of faces to the air.
        paint, reflectance: ``(face,)`` what lies on such faces, and what that sends back.
        sigma_s, sigma_a, g: of the rim, Henyey-Greenstein.
        albedo: of the coating.
        specular, lobe: reflectance and Beckmann roughness of its lobe (``tests.oracles.mesh_lobe``,
            which alone knows it).
        splits: ``(face, 2)`` tally bins along the two edges.
        bin: ``(face,)`` first tally bin of a face.
    """

    corner: Floats
    first: Floats
    second: Floats
    normal: Floats
    kind: Integers
    low: Floats
    cell: Floats
    shape: Integers
    start: Integers
    member: Integers
    index: float
    window: float
    alpha: Floats
    paint: Integers
    reflectance: Floats
    sigma_s: float
    sigma_a: float
    g: float
    albedo: float
    specular: float
    lobe: float
    splits: Integers
    bin: Integers


@compiled
def meet_triangle(pad: MeshPad, face: int, p: Floats, d: Floats) -> tuple[float, float, float]:
    """Return the way to a face and the barycentric weights of its edges; inf where it is missed."""
    a, b, c = pad.first[face], pad.second[face], pad.corner[face]
    px, py, pz = d[1] * b[2] - d[2] * b[1], d[2] * b[0] - d[0] * b[2], d[0] * b[1] - d[1] * b[0]
    determinant = a[0] * px + a[1] * py + a[2] * pz
    if determinant == 0.0:
        return math.inf, 0.0, 0.0
    x, y, z = p[0] - c[0], p[1] - c[1], p[2] - c[2]
    u = (x * px + y * py + z * pz) / determinant
    qx, qy, qz = y * a[2] - z * a[1], z * a[0] - x * a[2], x * a[1] - y * a[0]
    v = (d[0] * qx + d[1] * qy + d[2] * qz) / determinant
    if u < 0.0 or v < 0.0 or u + v > 1.0:
        return math.inf, 0.0, 0.0
    return (b[0] * qx + b[1] * qy + b[2] * qz) / determinant, u, v


@compiled
def nearest(pad: MeshPad, p: Floats, d: Floats, last: int, limit: float) -> tuple[float, int, int]:
    """Return way, face and tally bin of the first face before ``limit``, but for ``last``.

    The face is -1 where there is none.
    """
    best, found, bin_ = limit, -1, 0
    at, step, goal, stride = (
        np.empty(3, np.int64), np.empty(3, np.int64), np.empty(3), np.empty(3),
    )  # fmt: skip
    enter, leave = 0.0, limit
    for k in range(3):
        extent = pad.shape[k] * pad.cell[k]
        if d[k] == 0.0:
            if not 0.0 <= p[k] - pad.low[k] <= extent:
                return best, -1, 0
            continue
        s, t = (pad.low[k] - p[k]) / d[k], (pad.low[k] + extent - p[k]) / d[k]
        enter, leave = max(enter, min(s, t)), min(leave, max(s, t))
    if enter > leave:
        return best, -1, 0
    for k in range(3):
        offset = p[k] + enter * d[k] - pad.low[k]
        at[k] = min(pad.shape[k] - 1, max(0, int(offset / pad.cell[k])))
        step[k], goal[k], stride[k] = 0, math.inf, math.inf
        if d[k] != 0.0:
            step[k] = 1 if d[k] > 0.0 else -1
            wall = pad.low[k] + (at[k] + (1 if d[k] > 0.0 else 0)) * pad.cell[k]
            goal[k], stride[k] = (wall - p[k]) / d[k], pad.cell[k] / abs(d[k])
    while True:
        index = (at[2] * pad.shape[1] + at[1]) * pad.shape[0] + at[0]
        for i in range(pad.start[index], pad.start[index + 1]):
            face = pad.member[i]
            if face == last:
                continue
            t, u, v = meet_triangle(pad, face, p, d)
            if 1e-10 < t < best:
                best, found = t, face
                m, n = pad.splits[face, 0], pad.splits[face, 1]
                bin_ = pad.bin[face] + min(m - 1, int(u * m)) * n + min(n - 1, int(v * n))
        k = 0 if goal[0] <= goal[1] else 1
        k = k if goal[k] <= goal[2] else 2
        # A face found in a later cell cannot be nearer.
        if best <= goal[k] or goal[k] > leave:
            return best, found, bin_
        at[k] += step[k]
        if at[k] < 0 or at[k] >= pad.shape[k]:
            return best, found, bin_
        goal[k] += stride[k]


@compiled
def meet_tilted_face(
    state: NDArray[np.uint64], d: Floats, n: Floats, alpha: float, eta: float
) -> tuple[float, bool]:
    """Turn ``d`` at a face with unit normal ``n``: ``meet_face`` in that face's frame."""
    k = 0 if abs(n[0]) < 0.6 else 1
    s = np.zeros(3)
    s[k] = 1.0
    s -= n[k] * n
    s /= math.sqrt(s[0] * s[0] + s[1] * s[1] + s[2] * s[2])
    t = np.array([n[1] * s[2] - n[2] * s[1], n[2] * s[0] - n[0] * s[2], n[0] * s[1] - n[1] * s[0]])
    local = np.array(
        [
            d[0] * s[0] + d[1] * s[1] + d[2] * s[2],
            d[0] * t[0] + d[1] * t[1] + d[2] * t[2],
            d[0] * n[0] + d[1] * n[1] + d[2] * n[2],
        ]
    )
    weight, through = meet_face(state, local, 2, alpha, eta)
    d[:] = local[0] * s + local[1] * t + local[2] * n
    d /= math.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
    return weight, through


@compiled
def follow(
    state: NDArray[np.uint64],
    pad: MeshPad,
    p: Floats,
    d: Floats,
    weight: float,
    last: int,
    place: int,
    ends: Floats,
) -> tuple[float, int, int]:
    """Follow a ray to the coating; return weight, face and tally bin there.

    ``last`` is the coated face that it leaves, or -1, and ``place`` what it begins in. Weight 0: it
    ended elsewhere, and is accounted for in ``ends``.
    """
    extinction = pad.sigma_s + pad.sigma_a
    for _ in range(MAX_EVENTS):
        limit = math.inf
        if place == RIM and extinction > 0.0:
            limit = -math.log(1.0 - uniform(state)) / extinction
        way, face, bin_ = nearest(pad, p, d, last, limit)
        if face < 0 and way == math.inf:
            ends[OUTSIDE if place == AIR else LEAKED] += weight
            return 0.0, -1, 0
        for k in range(3):
            p[k] += way * d[k]
        last = face
        if face < 0:
            if uniform(state) * extinction >= pad.sigma_s:
                ends[MEDIUM] += weight
                return 0.0, -1, 0
            henyey_greenstein(state, d, pad.g)
            continue
        n, kind = pad.normal[face], pad.kind[face]
        along = d[0] * n[0] + d[1] * n[1] + d[2] * n[2]
        if kind == COATED:
            if along < 0.0:
                return weight, face, bin_
            ends[BACK] += weight
            return 0.0, -1, 0
        if kind == INTERFACE:
            place = CLEAR if along > 0.0 else RIM
            continue
        if kind == BOND:
            eta = pad.window / pad.index if along > 0.0 else pad.index / pad.window
            # Smooth: nothing is masked.
            _, through = meet_tilted_face(state, d, n, 0.0, eta)
            if through:
                place = WINDOW if along > 0.0 else CLEAR
            continue
        inside, index = CLEAR if kind == OUTER_CLEAR else RIM, pad.index
        if kind == OUTER_WINDOW:
            inside, index = WINDOW, pad.window
        if pad.paint[face] != OPEN:
            if along < 0.0 or not meet_paint(state, d, -n, pad.paint[face], pad.reflectance[face]):
                ends[PAINTED] += weight
                return 0.0, -1, 0
            continue
        through, left = True, 1.0
        if index > 1.0:
            eta = index if along < 0.0 else 1.0 / index
            left, through = meet_tilted_face(state, d, n, pad.alpha[face], eta)
            ends[MICROFACETS] += weight * (1.0 - left)
            weight *= left
            if weight == 0.0:
                return 0.0, -1, 0
        if through:
            place = inside if along < 0.0 else AIR
    ends[MICROFACETS] += weight
    return 0.0, -1, 0


@compiled
def trace_photons_on_mesh(
    pad: MeshPad, lamp: Lamp, place: int, count: int, seed: int, bins: int
) -> tuple[Floats, Floats]:
    """Return the power that arrives in every bin ``(bin,)`` and where power ends ``(end,)``.

    ``count`` photons share the lamp's power of 1; one that is reflected arrives again. ``place`` is
    what the lamp is in.
    """
    state = np.full(1, seed, dtype=np.uint64) * np.uint64(0xD1342543DE82EF95)
    tally, ends = np.zeros(bins), np.zeros(ENDS + 1)
    p, d = np.zeros(3), np.zeros(3)
    for _ in range(count):
        emit(state, lamp, p, d)
        weight, face, bin_ = follow(state, pad, p, d, 1.0, -1, place, ends)
        while weight > 0.0:
            tally[bin_] += weight
            if uniform(state) >= pad.albedo:
                ends[COATING] += weight
                break
            lambertian(state, d, pad.normal[face])
            weight, face, bin_ = follow(state, pad, p, d, weight, face, CLEAR, ends)
    return tally / count, ends / count


@compiled
def trace_views_on_mesh(
    pad: MeshPad, origin: Floats, directions: Floats, seed: int
) -> tuple[Integers, Floats, Floats]:
    """Return bin ``(ray,)``, direction ``(ray, 3)`` and weight ``(ray,)`` at the skin.

    ``origin (3,)`` in the air, ``directions (ray, 3)``; weight 0 where a ray does not get there.
    """
    state = np.full(1, seed, dtype=np.uint64) * np.uint64(0xD1342543DE82EF95)
    p, d, ends = np.zeros(3), np.zeros(3), np.zeros(ENDS + 1)
    count = len(directions)
    bins, arrived, weights = np.zeros(count, np.int64), np.zeros((count, 3)), np.zeros(count)
    for ray in range(count):
        p[:] = origin
        d[:] = directions[ray]
        weights[ray], _, bins[ray] = follow(state, pad, p, d, 1.0, -1, AIR, ends)
        arrived[ray] = d
    return bins, arrived, weights
