"""Analog photons in a flat pad: an oracle for level 2 that shares no code with it.

The pad is a box of clear silicone under a Lambertian coating, pressed by convex pyramids or not,
with an index-matched scattering rim around it or not. All faces are planes: a ray meets the box by
slabs and a pyramid by clipping it with the pyramid's half-spaces, so there are no meshes. Photons
carry no importance and are joined with nothing: they are emitted in proportion to the lamp's power,
reflected or refracted by chance, scattered and absorbed by chance. Only a rough face changes their
weight, by the part that masking and shadowing leave.

A rough face is that of Walter et al. 2007, "Microfacet models for refraction through rough
surfaces": Beckmann's distribution, of which normals are drawn with density ``D(m) |m.n|``, and
separable Smith shadowing in their rational form (eq. 27), as in Mitsuba's ``roughdielectric``.

A painted face touches its paint or metal without air between: photons survive by its reflectance,
about its normal by Lambert's law or as from a mirror. From outside it takes all.

Flat frame of a scene, mm: x across, y from base to tip, z from the camera-side face (0) to the
coating. Everything is float64.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

MAX_EVENTS = 1_000_000
"""Events after which a photon counts as lost: only light that circles without loss gets there."""
AHEAD = 1e-9
"""Shortest way (mm) to a plane that is not the one a ray starts on."""

(
    LEFT, RIGHT, BASE, TIP, LOWER, UPPER, OUTSIDE, MEDIUM, COATING, BACK, MICROFACETS, PAINTED,
) = range(12)  # fmt: skip
"""Where power ends: through a face of the box, never inside, absorbed in the rim, in the coating
or on its back, masked and shadowed, absorbed by painted faces."""
ENDS = 12
OPEN, LAMBERTIAN, MIRROR = range(3)
"""What lies on a face of the box: air, paint or metal."""


class Pad(NamedTuple):
    """What photons move in; lengths in mm, coefficients in 1/mm.

    Arguments:
        low, high: ``(3,)`` corners of the box, rim included.
        half_width, half_length: of the clear pad: the rim is what lies beyond.
        index: of the silicone; 1 is no face at all.
        alpha: ``(6,)`` Beckmann roughness of the faces to the air, in the order of where power
            ends (left, right, base, tip, lower, upper); 0 is smooth.
        paint, reflectance: ``(6,)`` what lies on the faces, and what that sends back.
        sigma_s, sigma_a, g: of the rim, Henyey-Greenstein.
        albedo: of the coating.
        apex: ``(site, 3)`` deepest points of the pyramids; none for an untouched pad.
        normal: ``(facet, 3)`` unit normals of a pyramid's facets, into the silicone.
        radius: of the circle around a pyramid's base.
        subdivisions: of an edge of a facet into tally bins.
        pitch: of the tally's grid on the flat coating.
        columns, rows: of that grid.
        specular, lobe: reflectance and Beckmann roughness of the coating's lobe
            (``tests.oracles.skin_lobe``, which alone knows it).
    """

    low: Floats
    high: Floats
    half_width: float
    half_length: float
    index: float
    alpha: Floats
    paint: NDArray[np.int64]
    reflectance: Floats
    sigma_s: float
    sigma_a: float
    g: float
    albedo: float
    apex: Floats
    normal: Floats
    radius: float
    subdivisions: int
    pitch: float
    columns: int
    rows: int
    specular: float = 0.0
    lobe: float = 1.0


class Lamp(NamedTuple):
    """A disk of radius ``radius`` mm at ``center`` that shines along column 2 of ``frame``.

    Radiance falls off as ``exp(-(theta / (2 sigma_v))^2)`` up to a right angle, or with an
    ``exponent`` above 0 intensity as that power of the cosine; the power is 1.
    """

    center: Floats
    frame: Floats
    radius: float
    sigma_v: float
    exponent: float = 0.0


def compiled(function: Any) -> Any:
    """Compile with numba, once per machine."""
    return numba.njit(nogil=True, cache=True)(function)


# ------------------------------------ Random numbers --------------------------------------


@compiled
def uniform(state: NDArray[np.uint64]) -> float:
    """Return a number in [0, 1): splitmix64 (Steele 2014) of the counter ``state`` ``(1,)``."""
    state[0] += np.uint64(0x9E3779B97F4A7C15)
    z = state[0]
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    return float(z >> np.uint64(11)) * 1.1102230246251565e-16


# ------------------------------------ Faces and lobes -------------------------------------


@compiled
def fresnel(cos_in: float, eta: float) -> tuple[float, float]:
    """Return unpolarized reflectance and cosine of refraction; ``eta`` is behind over in front."""
    squared = 1.0 - (1.0 - cos_in * cos_in) / (eta * eta)
    if squared <= 0.0:
        return 1.0, 0.0
    cos_out = math.sqrt(squared)
    s = (cos_in - eta * cos_out) / (cos_in + eta * cos_out)
    p = (eta * cos_in - cos_out) / (eta * cos_in + cos_out)
    return 0.5 * (s * s + p * p), cos_out


@compiled
def smith(cos: float, alpha: float) -> float:
    """Return what is neither masked nor shadowed at ``|cos|`` to the face."""
    sin_squared = 1.0 - cos * cos
    if sin_squared <= 0.0:
        return 1.0
    a = abs(cos) / (alpha * math.sqrt(sin_squared))
    if a >= 1.6:
        return 1.0
    return (3.535 * a + 2.181 * a * a) / (1.0 + 2.276 * a + 2.577 * a * a)


@compiled
def meet_face(
    state: NDArray[np.uint64], d: Floats, axis: int, alpha: float, eta: float
) -> tuple[float, bool]:
    """Turn ``d`` ``(3,)`` at a face normal to ``axis``; return the weight and if it went through.

    ``eta`` is the index behind the face over the index in front. Weight 0: the light is lost.
    """
    first, second = (axis + 1) % 3, (axis + 2) % 3
    a, b, c = d[first], d[second], d[axis]
    side = -1.0 if c > 0.0 else 1.0
    ma, mb, mc, weight = 0.0, 0.0, side, 1.0
    if alpha > 0.0:
        slope = alpha * math.sqrt(-math.log(1.0 - uniform(state)))
        azimuth = 2.0 * math.pi * uniform(state)
        upright = 1.0 / math.sqrt(1.0 + slope * slope)
        ma, mb = slope * upright * math.cos(azimuth), slope * upright * math.sin(azimuth)
        mc = side * upright
    cos_in = -(a * ma + b * mb + c * mc)
    if cos_in <= 0.0 or c == 0.0:
        return 0.0, False
    reflectance, cos_out = fresnel(cos_in, eta)
    if alpha > 0.0:
        weight = cos_in * smith(c, alpha) / abs(c * mc)
    through = uniform(state) >= reflectance
    if through:
        scale, along = 1.0 / eta, cos_in / eta - cos_out
    else:
        scale, along = 1.0, 2.0 * cos_in
    d[first], d[second], d[axis] = scale * a + along * ma, scale * b + along * mb, (
        scale * c + along * mc
    )  # fmt: skip
    if (d[axis] * side < 0.0) != through:
        return 0.0, through
    if alpha > 0.0:
        weight *= smith(d[axis], alpha)
    return weight, through


@compiled
def turn(d: Floats, cos: float, azimuth: float) -> None:
    """Turn ``d`` by ``acos(cos)``, about itself by ``azimuth``."""
    sin = math.sqrt(max(0.0, 1.0 - cos * cos))
    x, y, z = d[0], d[1], d[2]
    around_s, around_t = sin * math.cos(azimuth), sin * math.sin(azimuth)
    flat = math.hypot(x, y)
    if flat < 1e-12:
        d[0], d[1], d[2] = around_s, around_t, math.copysign(cos, z)
        return
    # s is horizontal, t completes the frame.
    d[0] = around_s * -y / flat + around_t * -x * z / flat + cos * x
    d[1] = around_s * x / flat + around_t * -y * z / flat + cos * y
    d[2] = around_t * flat + cos * z
    norm = math.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
    d[0] /= norm
    d[1] /= norm
    d[2] /= norm


@compiled
def henyey_greenstein(state: NDArray[np.uint64], d: Floats, g: float) -> None:
    """Turn ``d`` by one scattering event."""
    u = uniform(state)
    cos = 2.0 * u - 1.0
    if abs(g) > 1e-6:
        cos = (1.0 + g * g - ((1.0 - g * g) / (1.0 + g * cos)) ** 2) / (2.0 * g)
    turn(d, min(1.0, max(-1.0, cos)), 2.0 * math.pi * uniform(state))


@compiled
def lambertian(state: NDArray[np.uint64], d: Floats, normal: Floats) -> None:
    """Set ``d`` to a direction about ``normal``, in proportion to its cosine."""
    d[:] = normal
    turn(d, math.sqrt(uniform(state)), 2.0 * math.pi * uniform(state))


@compiled
def meet_paint(
    state: NDArray[np.uint64], d: Floats, normal: Floats, paint: int, reflectance: float
) -> bool:
    """Turn ``d`` at painted silicone, ``normal`` into it; return whether the light goes on."""
    if uniform(state) >= reflectance:
        return False
    if paint == MIRROR:
        onto = 2.0 * (d[0] * normal[0] + d[1] * normal[1] + d[2] * normal[2])
        for k in range(3):
            d[k] -= onto * normal[k]
    else:
        lambertian(state, d, normal)
    return True


@compiled
def emit(state: NDArray[np.uint64], lamp: Lamp, p: Floats, d: Floats) -> None:
    """Set ``p`` and ``d`` to a ray of the lamp, in proportion to its power."""
    mass = -math.expm1(-((math.pi / (4.0 * lamp.sigma_v)) ** 2))
    theta = math.acos((1.0 - uniform(state)) ** (1.0 / (lamp.exponent + 1.0)))
    while lamp.exponent == 0.0:
        theta = 2.0 * lamp.sigma_v * math.sqrt(-math.log1p(-mass * uniform(state)))
        if uniform(state) * theta <= math.sin(theta) * math.cos(theta):
            break
    r, at = lamp.radius * math.sqrt(uniform(state)), 2.0 * math.pi * uniform(state)
    azimuth = 2.0 * math.pi * uniform(state)
    u, v = r * math.cos(at), r * math.sin(at)
    a, b = math.sin(theta) * math.cos(azimuth), math.sin(theta) * math.sin(azimuth)
    c = math.cos(theta)
    for k in range(3):
        f = lamp.frame[k]
        p[k] = lamp.center[k] + u * f[0] + v * f[1]
        d[k] = a * f[0] + b * f[1] + c * f[2]


# ----------------------------------- Where rays arrive ------------------------------------


@compiled
def meet_pyramids(pad: Pad, p: Floats, d: Floats, way: float) -> tuple[float, int, int]:
    """Return way, site and facet of the first pyramid before ``way``; site -1 where there is none.

    A pyramid is what lies behind all its facets: a ray enters it last through the plane it meets
    last, and before it has left any.
    """
    found, at_site, at_facet = way, -1, -1
    span = d[0] * d[0] + d[1] * d[1]
    for site in range(pad.apex.shape[0]):
        x, y, z = p[0] - pad.apex[site, 0], p[1] - pad.apex[site, 1], p[2] - pad.apex[site, 2]
        if max(z, z + found * d[2]) < 0.0:
            continue
        # The nearest the ray's line comes to the pyramid's axis, and the ray itself.
        if (x * d[1] - y * d[0]) ** 2 > span * pad.radius**2:
            continue
        enter, leave, facet = AHEAD, found, -1
        for k in range(pad.normal.shape[0]):
            n = pad.normal[k]
            before = n[0] * x + n[1] * y + n[2] * z
            speed = n[0] * d[0] + n[1] * d[1] + n[2] * d[2]
            if speed < 0.0:
                t = -before / speed
                if t > enter:
                    enter, facet = t, k
            elif before > 0.0:
                enter = math.inf
            elif speed > 0.0:
                leave = min(leave, -before / speed)
            if enter >= leave:
                break
        if enter < leave and facet >= 0:
            found, at_site, at_facet = enter, site, facet
    return found, at_site, at_facet


@compiled
def enter_pad(state: NDArray[np.uint64], pad: Pad, p: Floats, d: Floats, ends: Floats) -> float:
    """Take a ray of weight 1 from the air into the box; return its weight, 0 where it ended.

    One that begins inside is there already.
    """
    inside = True
    for k in range(3):
        inside &= pad.low[k] < p[k] < pad.high[k]
    if inside:
        return 1.0
    near, far, axis = 0.0, math.inf, -1
    for k in range(3):
        if d[k] == 0.0:
            if p[k] < pad.low[k] or p[k] > pad.high[k]:
                far = -1.0
            continue
        a, b = (pad.low[k] - p[k]) / d[k], (pad.high[k] - p[k]) / d[k]
        if min(a, b) > near:
            near, axis = min(a, b), k
        far = min(far, max(a, b))
    if axis < 0 or near >= far:
        ends[OUTSIDE] += 1.0
        return 0.0
    for k in range(3):
        p[k] += near * d[k]
    p[axis] = pad.low[axis] if d[axis] > 0.0 else pad.high[axis]
    if axis == 2 and d[2] < 0.0 and abs(p[0]) < pad.half_width and abs(p[1]) < pad.half_length:
        ends[BACK] += 1.0
        return 0.0
    face = 2 * axis + (0 if d[axis] > 0.0 else 1)
    if pad.paint[face] != OPEN:
        ends[PAINTED] += 1.0
        return 0.0
    if pad.index == 1.0:
        return 1.0
    weight, through = meet_face(state, d, axis, pad.alpha[face], pad.index)
    ends[MICROFACETS] += 1.0 - weight
    if not through:
        ends[OUTSIDE] += weight
        return 0.0
    return weight


@compiled
def arrive(
    state: NDArray[np.uint64], pad: Pad, p: Floats, d: Floats, weight: float, ends: Floats
) -> tuple[float, int, int]:  # fmt: skip
    """Follow a ray inside the box to the coating; return weight, site and facet there.

    Weight 0: it ended elsewhere, and is accounted for in ``ends``. Site -1: the flat coating.
    """
    extinction = pad.sigma_s + pad.sigma_a
    for _ in range(MAX_EVENTS):
        # ------------------------------ The next face ---------------------------------
        way, axis = math.inf, -1
        for k in range(3):
            if d[k] != 0.0:
                t = ((pad.high[k] if d[k] > 0.0 else pad.low[k]) - p[k]) / d[k]
                if t < way:
                    way, axis = t, k
        way, site, facet = meet_pyramids(pad, p, d, max(way, 0.0))
        # -------------------------- The border of the rim -----------------------------
        border = False
        if extinction > 0.0:
            for k, plane in (
                (0, pad.half_width), (0, -pad.half_width), (1, pad.half_length),
                (1, -pad.half_length),
            ):  # fmt: skip
                if d[k] != 0.0:
                    t = (plane - p[k]) / d[k]
                    if AHEAD < t < way:
                        way, border = t, True
            x, y = p[0] + 0.5 * way * d[0], p[1] + 0.5 * way * d[1]
            if abs(x) > pad.half_width or abs(y) > pad.half_length:
                free = -math.log(1.0 - uniform(state)) / extinction
                if free < way:
                    for k in range(3):
                        p[k] += free * d[k]
                    if uniform(state) * extinction >= pad.sigma_s:
                        ends[MEDIUM] += weight
                        return 0.0, -1, -1
                    henyey_greenstein(state, d, pad.g)
                    continue
        for k in range(3):
            p[k] += way * d[k]
        if border:
            continue
        # ------------------------------ What is there ---------------------------------
        if site >= 0:
            return weight, site, facet
        p[axis] = pad.high[axis] if d[axis] > 0.0 else pad.low[axis]
        if (
            axis == 2
            and d[2] > 0.0
            and abs(p[0]) <= pad.half_width
            and abs(p[1]) <= pad.half_length + 1e-9
        ):  # fmt: skip
            return weight, -1, -1
        face = 2 * axis + (1 if d[axis] > 0.0 else 0)
        if pad.paint[face] != OPEN:
            inwards = np.zeros(3)
            inwards[axis] = -1.0 if d[axis] > 0.0 else 1.0
            if not meet_paint(state, d, inwards, pad.paint[face], pad.reflectance[face]):
                ends[PAINTED] += weight
                return 0.0, -1, -1
            continue
        if pad.index == 1.0:
            ends[face] += weight
            return 0.0, -1, -1
        left, through = meet_face(state, d, axis, pad.alpha[face], 1.0 / pad.index)
        ends[MICROFACETS] += weight * (1.0 - left)
        weight *= left
        if through or weight == 0.0:
            # The box is convex: what leaves it does not come back.
            ends[face] += weight
            return 0.0, -1, -1
    ends[MICROFACETS] += weight
    return 0.0, -1, -1


@compiled
def tally_bin(pad: Pad, p: Floats, site: int, facet: int) -> int:
    """Return the bin of a point on the coating: those of the facets first, then the grid's."""
    m, faces = pad.subdivisions, pad.normal.shape[0]
    if site < 0:
        i = min(pad.columns - 1, max(0, int((p[0] + pad.half_width) / pad.pitch)))
        j = min(pad.rows - 1, max(0, int((p[1] + pad.half_length) / pad.pitch)))
        return pad.apex.shape[0] * faces * m * m + j * pad.columns + i
    azimuth = 2.0 * math.pi * facet / faces
    x, y = p[0] - pad.apex[site, 0], p[1] - pad.apex[site, 1]
    # 0 at the apex, 1 at the base; -1 and 1 along the edges that leave the apex.
    out = (math.sin(azimuth) * x + math.cos(azimuth) * y) / (pad.radius * math.cos(math.pi / faces))
    across = (math.cos(azimuth) * x - math.sin(azimuth) * y) / (
        pad.radius * math.sin(math.pi / faces)
    )
    i = min(m - 1, max(0, int(0.5 * m * (out - across))))
    j = min(m - 1 - i, max(0, int(0.5 * m * (out + across))))
    return ((site * faces + facet) * m + i) * m + j


# ------------------------------------- Whole runs -----------------------------------------


@compiled
def trace_photons(pad: Pad, lamp: Lamp, count: int, seed: int, bins: int) -> tuple[Floats, Floats]:
    """Return the power that arrives in every bin ``(bin,)`` and where power ends ``(end,)``.

    ``count`` photons share the lamp's power of 1; one that is reflected arrives again.
    """
    state = np.full(1, seed, dtype=np.uint64) * np.uint64(0xD1342543DE82EF95)
    tally, ends = np.zeros(bins), np.zeros(ENDS)
    p, d, down = np.zeros(3), np.zeros(3), np.array([0.0, 0.0, -1.0])
    for _ in range(count):
        emit(state, lamp, p, d)
        weight = enter_pad(state, pad, p, d, ends)
        while weight > 0.0:
            weight, site, facet = arrive(state, pad, p, d, weight, ends)
            if weight == 0.0:
                break
            tally[tally_bin(pad, p, site, facet)] += weight
            if uniform(state) >= pad.albedo:
                ends[COATING] += weight
                break
            lambertian(state, d, down if site < 0 else pad.normal[facet])
    return tally / count, ends / count


@compiled
def trace_views(
    pad: Pad,
    origin: Floats,
    directions: Floats,
    target: NDArray[np.int64],
    seed: int,
    views: Floats,
) -> None:
    """Add to ``views`` ``(target, bin)`` the weight with which rays from the camera see the bins.

    ``origin (3,)`` in the air, ``directions (ray, 3)``, ``target (ray,)``.
    """
    state = np.full(1, seed, dtype=np.uint64) * np.uint64(0xD1342543DE82EF95)
    p, d, ends = np.zeros(3), np.zeros(3), np.zeros(ENDS)
    for ray in range(directions.shape[0]):
        p[:] = origin
        d[:] = directions[ray]
        weight, site, facet = enter_pad(state, pad, p, d, ends), -1, -1
        if weight > 0.0:
            weight, site, facet = arrive(state, pad, p, d, weight, ends)
        if weight > 0.0:
            views[target[ray], tally_bin(pad, p, site, facet)] += weight
