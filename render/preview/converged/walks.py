"""Compiled light paths in the bent block: through the clear pad and in the diffusive layer.

Frame of this file (mm): ``x`` across, ``v = y - pivot``, ``w = thickness - z`` in the world frame
of `render.geometry.bending`: the origin lies on the coating, ``w`` grows towards the camera.
With the coating's curvature kappa, the level ``g = kappa (v^2 + w^2) / 2 + w`` of a point at depth
delta below the coating is ``delta + kappa delta^2 / 2`` at any bend, 0 included; ends of the block
are planes through the bend's axis. So every face is a plane or a quadric and there are no meshes.
A flat block may be two clear media, pad over window, which meet at the plane of depth ``bond``.

Paths are analog (a photon lives or dies) but for masking at rough faces. Faces: Walter et al. 2007
with Beckmann's distribution and the separable Smith shadowing of Mitsuba's ``roughdielectric``, of
which `render.geometry.microfacets` is the vectorized form.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from render.arrays import Array
from render.compiled import compiled

State = NDArray[np.uint64]

(
    LEFT, TIP, RIGHT, BASE, COATING, FACET, LOWER, UPPER, START, END, OUTER_LEFT, OUTER_RIGHT, BOND,
    NONE,
) = range(14)  # fmt: skip
"""Faces; the first four are the edges of the clear pad. Where a layer lies on one light passes
straight, and meets an outer one behind it."""
MAX_EVENTS = 100_000
"""Events after which a path counts as lost: only light that circles without loss gets there."""
TRAPPED_EVENTS = 500
"""Faces of a window that light of a lamp in it meets in a row, after which it is taken to be lost:
between smooth faces much of it circles without loss."""
SKIMMING = 1e-3
"""Sine of the angle to a bent coating below which light is left out where it is received."""
BLOCK_TOLERANCE = 1e-7
"""mm by which rounding may move a point out of the block."""


class Block(NamedTuple):
    """What light moves in; lengths in mm, coefficients in 1/mm, the frame of this file.

    Arguments:
        kappa: curvature of the coating.
        level: of the lower face.
        half_width: of the clear pad; ``rims`` ``(4,)`` the thickness of the layer on left, tip,
            right and base, 0 without one.
        base, tip, start, end: planes ``(cos, sin, offset)`` through the bend's axis: the pad's base
            and tip, and the outer faces of the layer there. ``cos v - sin w - offset`` grows to the
            tip.
        index: of refraction, of the silicone.
        bond: depth below the coating at which a window of another index is bonded to a flat pad,
            infinite without one; ``window`` its index.
        alpha: ``(face,)`` Beckmann roughness of the faces to the air, by their number here; of the
            layer's inner faces where there is no layer, and they lie in the air.
        paint: ``(face, 2)`` reflectance of what is painted, -1 where there is air; and 1 where it
            is a mirror, 0 where it is Lambertian.
        sigma_s, sigma_a, g: of the layer.
        wide: light that the layer has scattered so often belongs to the exit field.
        sites: ``(site, 3)`` centers of the pyramids; none of an untouched pad.
        reach: radius of a ball about a center that holds the pyramid.
        normal: ``(site, facet, 3)`` unit normals of facets, into the silicone.
        offset: ``(site, facet)`` their planes: ``normal . p = offset``.
        patch: ``(4,)`` columns and rows of coating patches, half the pad's length, the pivot.
        skin: ``(3,)`` albedo, specular reflectance and Beckmann roughness of the coating.
    """

    kappa: float
    level: float
    half_width: float
    rims: Array
    base: Array
    tip: Array
    start: Array
    end: Array
    index: float  # type: ignore[assignment]  # of refraction, not tuple.index
    bond: float
    window: float
    alpha: Array
    paint: Array
    sigma_s: float
    sigma_a: float
    g: float
    wide: int
    sites: Array
    reach: float
    normal: Array
    offset: Array
    patch: Array
    skin: Array


class FaceGrid(NamedTuple):
    """Cells on the layer's inner faces, in each of which light is a polynomial.

    Per cell: degree 1 along the edge times degree 1 upwards times the monomials
    ``a^i b^j (i + j <= degree)`` and ``c a^i b^j (i + j < degree)`` of the direction (a along the
    edge, b to the coating, c into the pad): ``4 (degree + 1)^2`` terms, not yet orthonormal.

    Arguments:
        first: ``(4,)`` number of each edge's first column of cells.
        columns: ``(4,)`` how many there are along each edge; 0 where no layer lies on it.
        half: ``(4,)`` half the length of each edge.
        rows: cells above each other.
        thickness: of the pad.
        degree: in the direction.
    """

    first: NDArray[np.int64]
    columns: NDArray[np.int64]
    half: Array
    rows: int
    thickness: float
    degree: int


class Receivers(NamedTuple):
    """Small faces at the sites that gather the light which passes near them; mm.

    Arguments:
        site: ``(site, 3)`` where each site touches the coating; ``inward`` ``(site, 3)`` the unit
            normal of the coating there, into the pad.
        center, normal: ``(site, receiver, 3)``; normals are unit and point into the pad.
        corners: ``(site, receiver, 3, 3)`` of a triangle on which shadows are looked for.
        shaded: ``(receiver,)`` whether pyramids hide light from it.
        radius: of the disk parallel to the coating, about the center, over which light is alike.
        reach: radius of a ball about a site that holds all of its disks.
        sights: ``(site, receiver, sight, 3)`` unit directions of lines of sight onto receivers, as
            likely as each other; none where the coating has no lobe.
    """

    site: Array
    inward: Array
    center: Array
    normal: Array
    corners: Array
    shaded: NDArray[np.bool_]
    radius: float
    reach: float
    sights: Array


# ------------------------------------ Random numbers --------------------------------------


@compiled
def uniform(state: State) -> float:
    """Return a number in [0, 1): splitmix64 (Steele et al. 2014) of the counter ``state``."""
    state[0] += np.uint64(0x9E3779B97F4A7C15)
    z = state[0]
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    return float(z >> np.uint64(11)) * 2.0**-53


@compiled
def begin_stream(state: State, key: int, index: int) -> None:
    """Start the stream of path ``index`` in the family ``key``: its numbers depend on these alone.

    ``state`` is ``(1,)``, the counter of a splitmix64 generator (Steele et al. 2014).
    """
    mixed = np.uint64(index) * np.uint64(0xD1342543DE82EF95) + np.uint64(key)
    mixed = (mixed ^ (mixed >> np.uint64(32))) * np.uint64(0xDABA0B6EB09322E3)
    mixed = (mixed ^ (mixed >> np.uint64(32))) * np.uint64(0xDABA0B6EB09322E3)
    state[0] = mixed ^ (mixed >> np.uint64(32))


# ---------------------------------------- Faces -------------------------------------------


@compiled
def turn(d: Array, cos: float, azimuth: float) -> None:
    """Turn the unit vector ``d`` by the angle of cosine ``cos`` (frame of Duff et al. 2017)."""
    x, y, z = d[0], d[1], d[2]
    sign = 1.0 if z >= 0.0 else -1.0
    a = -1.0 / (sign + z)
    b = x * y * a
    sin = math.sqrt(max(0.0, 1.0 - cos * cos))
    s, t = sin * math.cos(azimuth), sin * math.sin(azimuth)
    d[0] = s * (1.0 + sign * x * x * a) + t * b + cos * x
    d[1] = s * sign * b + t * (sign + y * y * a) + cos * y
    d[2] = -s * sign * x - t * y + cos * z
    scale = 1.0 / math.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
    d *= scale


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
def unmasked(cos: float, alpha: float) -> float:
    """Return Smith's G1 for Beckmann roughness (Walter 2007, eq. 27)."""
    squared = 1.0 - cos * cos
    if alpha == 0.0 or squared <= 0.0:
        return 1.0
    a = abs(cos) / (alpha * math.sqrt(squared))
    if a >= 1.6:
        return 1.0
    return (3.535 * a + 2.181 * a * a) / (1.0 + 2.276 * a + 2.577 * a * a)


@compiled
def microfacet(d: Array, n: Array, alpha: float, u: float, v: float, m: Array) -> float:
    """Draw a microfacet ``m`` that ``d`` meets; return its weight without shadowing behind it.

    ``n`` is the face's normal on the side that ``d`` comes from; ``m`` has density ``D(m) |m.n|``
    and counts by Walter 2007, eq. 41. 0 where it is met from behind.
    """
    m[:] = n
    if alpha > 0.0:
        cos = 1.0 / math.sqrt(1.0 - alpha * alpha * math.log(1.0 - u))
        turn(m, cos, 2.0 * math.pi * v)
    cos_in = -(d[0] * m[0] + d[1] * m[1] + d[2] * m[2])
    cos_face = -(d[0] * n[0] + d[1] * n[1] + d[2] * n[2])
    cos_micro = m[0] * n[0] + m[1] * n[1] + m[2] * n[2]
    if cos_in <= 0.0 or cos_face <= 1e-9:
        return 0.0
    return float(cos_in * unmasked(cos_face, alpha) / (cos_face * cos_micro))


@compiled
def reflect_inside(
    block: Block, face: int, index: float, d: Array, n: Array, u: float, v: float, chance: float,
    m: Array,
) -> float:  # fmt: skip
    """Turn ``d``, which meets an outer face with inward normal ``n``, back by chance.

    Return its weight; 0 where it leaves. ``index`` is that of the medium before the face; ``u``,
    ``v`` and ``chance`` are random in [0, 1).
    """
    reflectance = block.paint[face, 0]
    if reflectance >= 0.0:
        if chance >= reflectance:
            return 0.0
        if block.paint[face, 1] > 0.0:
            cos_in = -(d[0] * n[0] + d[1] * n[1] + d[2] * n[2])
            for k in range(3):
                d[k] += 2.0 * cos_in * n[k]
        else:
            d[:] = n
            turn(d, math.sqrt(1.0 - u), 2.0 * math.pi * v)
        return 1.0
    alpha = block.alpha[face]
    weight = microfacet(d, n, alpha, u, v, m)
    if weight == 0.0:
        return 0.0
    cos_in = -(d[0] * m[0] + d[1] * m[1] + d[2] * m[2])
    back, _ = fresnel(cos_in, 1.0 / index)
    if chance >= back:
        return 0.0
    for k in range(3):
        d[k] += 2.0 * cos_in * m[k]
    cos_out = d[0] * n[0] + d[1] * n[1] + d[2] * n[2]
    if cos_out <= 0.0:
        return 0.0
    return float(weight * unmasked(cos_out, alpha))


@compiled
def refract_into(
    block: Block, face: int, index: float, d: Array, n: Array, u: float, v: float, m: Array
) -> float:
    """Turn ``d``, which comes from the air, into what has ``index``; return what passes of it.

    ``n`` is the face's outward normal.
    """
    alpha = block.alpha[face]
    weight = microfacet(d, n, alpha, u, v, m)
    if weight == 0.0:
        return 0.0
    cos_in = -(d[0] * m[0] + d[1] * m[1] + d[2] * m[2])
    back, cos_out = fresnel(cos_in, index)
    for k in range(3):
        d[k] = d[k] / index + (cos_in / index - cos_out) * m[k]
    behind = -(d[0] * n[0] + d[1] * n[1] + d[2] * n[2])
    if behind <= 0.0:
        return 0.0
    return weight * (1.0 - back) * unmasked(behind, alpha)


@compiled
def reflect_lobe(block: Block, d: Array, n: Array, u: float, v: float, m: Array) -> float:
    """Turn ``d`` back as the coating's lobe does, ``n`` the normal into the pad; return its weight.

    Microfacets that reflect everything: without the reflectance of the lobe.
    """
    weight = microfacet(d, n, block.skin[2], u, v, m)
    if weight == 0.0:
        return 0.0
    cos_in = -(d[0] * m[0] + d[1] * m[1] + d[2] * m[2])
    for k in range(3):
        d[k] += 2.0 * cos_in * m[k]
    cos_out = d[0] * n[0] + d[1] * n[1] + d[2] * n[2]
    if cos_out <= 0.0:
        return 0.0
    return float(weight * unmasked(cos_out, block.skin[2]))


@compiled
def sent_to(block: Block, d: Array, sight: Array, n: Array) -> float:
    """Return pi f over reflectance for light along ``d`` seen along ``sight``: 1 of Lambert's law.

    Both lead onto the coating, whose normal is ``n`` (Walter et al. 2007, eqs. 20 and 25).
    """
    albedo, specular, alpha = block.skin[0], block.skin[1], block.skin[2]
    cos_in = -(d[0] * n[0] + d[1] * n[1] + d[2] * n[2])
    cos_out = -(sight[0] * n[0] + sight[1] * n[1] + sight[2] * n[2])
    lobe = 0.0
    if cos_in > 1e-9 and cos_out > 1e-9:
        x, y, z = d[0] + sight[0], d[1] + sight[1], d[2] + sight[2]
        cos = x * n[0] + y * n[1] + z * n[2]
        squared = cos * cos / (x * x + y * y + z * z)
        peak = math.exp((1.0 - 1.0 / squared) / (alpha * alpha)) / (alpha * alpha)
        shadowed = unmasked(cos_in, alpha) * unmasked(cos_out, alpha)
        lobe = peak * shadowed / (4.0 * cos_in * cos_out * squared * squared)
    return float((albedo + specular * lobe) / (albedo + specular))


@compiled
def index_of(block: Block, below: bool) -> float:
    """Return the index of the window, where ``below``, or of the pad."""
    return block.window if below else block.index


@compiled
def meet_bond(block: Block, below: bool, d: Array, chance: float) -> bool:
    """Refract ``d`` at the smooth bond of pad and window, or reflect it by chance.

    Return whether it is ``below`` the bond afterwards. Powers of photons stay what they are; so do
    the weights of paths that follow light backwards, which stand for radiance over the index
    squared (Veach 1997, eq. 5.3).
    """
    eta = index_of(block, not below) / index_of(block, below)
    back, cos_out = fresnel(abs(d[2]), eta)
    if chance < back:
        d[2] = -d[2]
        return below
    d[0] /= eta
    d[1] /= eta
    d[2] = math.copysign(cos_out, d[2])
    return not below


# -------------------------------------- Geometry ------------------------------------------


@compiled
def beyond(plane: Array, p: Array) -> float:
    """Return how far (mm) a point lies towards the tip from a plane through the axis."""
    return float(plane[0] * p[1] - plane[1] * p[2] - plane[2])


@compiled
def way_to(plane: Array, p: Array, d: Array, sign: float) -> float:
    """Return the way (mm) to a plane through the axis that is passed towards the tip (1) or base.

    ``sign`` is -1 for the base; infinite where ``d`` leads the other way.
    """
    towards = plane[0] * d[1] - plane[1] * d[2]
    return -beyond(plane, p) / towards if sign * towards > 0.0 else math.inf


@compiled
def level_of(block: Block, p: Array) -> float:
    """Return the level g of a point."""
    return float(0.5 * block.kappa * (p[1] * p[1] + p[2] * p[2]) + p[2])


@compiled
def level_ways(block: Block, p: Array, d: Array) -> tuple[float, float]:
    """Return the ways (mm) to the coating's level and to that of the lower face from between."""
    a = 0.5 * block.kappa * (d[1] * d[1] + d[2] * d[2])
    b = block.kappa * (p[1] * d[1] + p[2] * d[2]) + d[2]
    c = max(0.0, level_of(block, p))
    up, down = math.inf, math.inf
    squared = b * b - 4.0 * a * c
    if b < 0.0 and squared >= 0.0:
        up = 2.0 * c / (math.sqrt(squared) - b)
    rest = max(0.0, block.level - c)
    root = math.sqrt(b * b + 4.0 * a * rest)
    if b >= 0.0:
        if b + root > 0.0:
            down = 2.0 * rest / (b + root)
    elif a > 0.0:
        down = (root - b) / (2.0 * a)
    return up, down


@compiled
def face_normal(block: Block, face: int, p: Array, n: Array) -> None:
    """Write the unit normal out of the block of a face to the air at ``p``."""
    n[:] = 0.0
    if face in (LOWER, UPPER):
        n[1], n[2] = block.kappa * p[1], block.kappa * p[2] + 1.0
        n *= (1.0 if face == LOWER else -1.0) / math.sqrt(n[1] * n[1] + n[2] * n[2])
    elif face in (START, BASE):
        n[1], n[2] = -block.base[0], block.base[1]
    elif face in (END, TIP):
        n[1], n[2] = block.end[0], -block.end[1]
    else:
        n[0] = -1.0 if face in (OUTER_LEFT, LEFT) else 1.0


@compiled
def meet_pyramids(block: Block, p: Array, d: Array, limit: float) -> tuple[float, int, int]:
    """Return way, site and facet of the first facet before ``limit``; site -1 for none."""
    best, site, facet = limit, -1, -1
    for i in range(len(block.sites)):
        x, y, z = block.sites[i, 0] - p[0], block.sites[i, 1] - p[1], block.sites[i, 2] - p[2]
        along = x * d[0] + y * d[1] + z * d[2]
        squared = x * x + y * y + z * z
        if along < -block.reach or squared - along * along > block.reach * block.reach:
            continue
        enter, leave, met = 1e-9, best, -1
        for k in range(block.normal.shape[1]):
            n = block.normal[i, k]
            speed = n[0] * d[0] + n[1] * d[1] + n[2] * d[2]
            room = block.offset[i, k] - n[0] * p[0] - n[1] * p[1] - n[2] * p[2]
            if speed < 0.0:
                if room / speed > enter:
                    enter, met = room / speed, k
            elif room < speed * leave:
                leave = room / speed if speed > 0.0 else -1.0
        if met >= 0 and enter < leave:
            best, site, facet = enter, i, met
    return best, site, facet


@compiled
def cross_clear(block: Block, below: bool, p: Array, d: Array) -> tuple[float, int, int, int]:
    """Return the way to the next face of the clear pad, the face, and site and facet of a FACET.

    ``below`` says that the point is in the window; rounding does not know it at the bond.
    """
    up, down = level_ways(block, p, d)
    way, face = (up, COATING) if up <= down else (down, LOWER)
    if block.bond < math.inf and (d[2] < 0.0 if below else d[2] > 0.0):
        way, face = (block.bond - p[2]) / d[2], BOND
    if d[0] != 0.0:
        to = (block.half_width - p[0]) / d[0] if d[0] > 0.0 else (-block.half_width - p[0]) / d[0]
        if to < way:
            way, face = to, RIGHT if d[0] > 0.0 else LEFT
    to = way_to(block.tip, p, d, 1.0)
    if to < way:
        way, face = to, TIP
    to = way_to(block.base, p, d, -1.0)
    if to < way:
        way, face = to, BASE
    way = max(way, 0.0)
    if len(block.sites):
        # As far as the lower face may reach, a pyramid is met first or not at all.
        before, site, facet = meet_pyramids(block, p, d, way)
        if site >= 0:
            return before, FACET, site, facet
    return way, face, -1, -1


@compiled
def cross_layer(block: Block, p: Array, d: Array) -> tuple[float, int]:
    """Return the way to the next face of the layer and the face."""
    up, down = level_ways(block, p, d)
    way, face = (up, UPPER) if up <= down else (down, LOWER)
    if d[0] > 0.0:
        to = (block.half_width + block.rims[RIGHT] - p[0]) / d[0]
        if to < way:
            way, face = to, OUTER_RIGHT
    elif d[0] < 0.0:
        to = (-block.half_width - block.rims[LEFT] - p[0]) / d[0]
        if to < way:
            way, face = to, OUTER_LEFT
    to = way_to(block.start, p, d, -1.0)
    if to < way:
        way, face = to, START
    to = way_to(block.end, p, d, 1.0)
    if to < way:
        way, face = to, END
    past, short = beyond(block.tip, p), -beyond(block.base, p)
    towards = block.tip[0] * d[1] - block.tip[1] * d[2]
    back = block.base[1] * d[2] - block.base[0] * d[1]
    if abs(p[0]) >= block.half_width and d[0] * p[0] < 0.0:
        to = (abs(p[0]) - block.half_width) / abs(d[0])
        if to < way and past + to * towards < 0.0 and short + to * back < 0.0:
            way, face = to, LEFT if d[0] > 0.0 else RIGHT
    if past >= 0.0 and towards < 0.0:
        to = -past / towards
        if to < way and abs(p[0] + to * d[0]) < block.half_width:
            way, face = to, TIP
    if short >= 0.0 and back < 0.0 and block.rims[BASE] > 0.0:
        to = -short / back
        if to < way and abs(p[0] + to * d[0]) < block.half_width:
            way, face = to, BASE
    return max(way, 0.0), face


@compiled
def within(block: Block, p: Array) -> bool:
    """Return whether the block holds a point, but for rounding."""
    level = level_of(block, p)
    return (
        p[0] <= block.half_width + block.rims[RIGHT] + BLOCK_TOLERANCE
        and -p[0] <= block.half_width + block.rims[LEFT] + BLOCK_TOLERANCE
        and beyond(block.start, p) >= -BLOCK_TOLERANCE
        and beyond(block.end, p) <= BLOCK_TOLERANCE
        and level >= -BLOCK_TOLERANCE
        and level <= block.level + BLOCK_TOLERANCE
    )


@compiled
def enter_block(block: Block, p: Array, d: Array) -> int:
    """Move a point in the air on to where its ray enters the block; return the face, or NONE."""
    best, found = math.inf, NONE
    q = np.empty(3)
    a = 0.5 * block.kappa * (d[1] * d[1] + d[2] * d[2])
    b = block.kappa * (p[1] * d[1] + p[2] * d[2]) + d[2]
    level = level_of(block, p)
    for face in (LOWER, UPPER, START, END, OUTER_LEFT, OUTER_RIGHT):
        to = math.inf
        if face == LOWER:
            over = level - block.level
            squared = b * b - 4.0 * a * over
            if over > 0.0 and b < 0.0 and squared >= 0.0:
                to = 2.0 * over / (math.sqrt(squared) - b)
        elif face == UPPER:
            root = math.sqrt(max(0.0, b * b - 4.0 * a * level))
            if level < 0.0 and b + root > 0.0:
                to = -2.0 * level / (b + root)
        elif face in (START, END):
            plane = block.start if face == START else block.end
            sign = 1.0 if face == START else -1.0
            speed = sign * (plane[0] * d[1] - plane[1] * d[2])
            if speed > 0.0:
                to = -sign * beyond(plane, p) / speed
        elif face == OUTER_LEFT and d[0] > 0.0:
            to = (-block.half_width - block.rims[LEFT] - p[0]) / d[0]
        elif face == OUTER_RIGHT and d[0] < 0.0:
            to = (block.half_width + block.rims[RIGHT] - p[0]) / d[0]
        if 0.0 <= to < best:
            for k in range(3):
                q[k] = p[k] + to * d[k]
            if within(block, q):
                best, found = to, face
    if found != NONE:
        for k in range(3):
            p[k] += best * d[k]
    return found


@compiled
def in_layer(block: Block, p: Array) -> bool:
    """Return whether a point of the block lies in the diffusive layer."""
    return (
        (block.rims[LEFT] > 0.0 and -p[0] > block.half_width)
        or (block.rims[RIGHT] > 0.0 and p[0] > block.half_width)
        or (block.rims[TIP] > 0.0 and beyond(block.tip, p) > 0.0)
        or (block.rims[BASE] > 0.0 and beyond(block.base, p) < 0.0)
    )


@compiled
def angle_of(block: Block, p: Array) -> tuple[float, float, float]:
    """Return sine and cosine of the local frame's turn at a point, and its flat ``v``."""
    y, w = block.kappa * p[1], 1.0 + block.kappa * p[2]
    scale = 1.0 / math.sqrt(y * y + w * w)
    flat = math.atan2(y, w) / block.kappa if block.kappa > 0.0 else p[1]
    return y * scale, w * scale, flat


@compiled
def patch_of(block: Block, p: Array) -> int:
    """Return the number of the coating's patch above a point."""
    columns, rows = int(block.patch[0]), int(block.patch[1])
    _, _, flat = angle_of(block, p)
    y = (flat + block.patch[3]) / block.patch[2]
    column = min(columns - 1, max(0, int(0.5 * (p[0] / block.half_width + 1.0) * columns)))
    row = min(rows - 1, max(0, int(0.5 * (y + 1.0) * rows)))
    return row * columns + column


# --------------------------------------- Walks --------------------------------------------


@compiled
def walk_layer(
    state: State, block: Block, p: Array, d: Array, n: Array, m: Array
) -> tuple[float, int, int]:
    """Walk in the layer until light leaves it through an inner face.

    Return its weight, the face, and how often it was scattered. Weight 0: it was absorbed or left
    into the air.
    """
    extinction, weight, scattered = block.sigma_s + block.sigma_a, 1.0, 0
    for _ in range(MAX_EVENTS):
        free = math.inf
        if extinction > 0.0:
            free = -math.log(1.0 - uniform(state)) / extinction
        way, face = cross_layer(block, p, d)
        step = min(way, free)
        for k in range(3):
            p[k] += step * d[k]
        if free < way:
            if uniform(state) * extinction >= block.sigma_s:
                return 0.0, NONE, scattered
            scattered += 1
            u, g = uniform(state), block.g
            cos = 2.0 * u - 1.0
            if abs(g) > 1e-3:
                ratio = (1.0 - g * g) / (1.0 - g + 2.0 * g * u)
                cos = (1.0 + g * g - ratio * ratio) / (2.0 * g)
            turn(d, max(-1.0, min(1.0, cos)), 2.0 * math.pi * uniform(state))
        elif face <= BASE:
            if face in (LEFT, RIGHT):
                p[0] = -block.half_width if face == LEFT else block.half_width
            return weight, face, scattered
        else:
            face_normal(block, face, p, n)
            for k in range(3):
                n[k] = -n[k]
            u, v, chance = uniform(state), uniform(state), uniform(state)
            weight *= reflect_inside(block, face, block.index, d, n, u, v, chance, m)
            if weight == 0.0:
                return 0.0, NONE, scattered
    return 0.0, NONE, scattered


@compiled
def deposit(
    block: Block, grid: FaceGrid, face: int, p: Array, d: Array, sign: float, weights: Array,
    powers: Array, out: Array,
) -> None:  # fmt: skip
    """Add light that crosses an inner face to ``out`` ``(cell, term, weight)``.

    ``sign * d`` points into the pad; ``weights`` ``(weight,)``; ``powers`` is scratch
    ``(2, degree + 1)``.
    """
    sine, cosine, flat = angle_of(block, p)
    tangent = sign * (d[1] * cosine - d[2] * sine)
    up = -sign * (d[1] * sine + d[2] * cosine)
    level = max(0.0, level_of(block, p))
    depth = 2.0 * level / (1.0 + math.sqrt(1.0 + 2.0 * block.kappa * level))
    height = 1.0 - depth / grid.thickness
    along, into, s = tangent, abs(d[0]), (flat + block.patch[3]) / grid.half[face]
    scale = 1.0
    if face in (TIP, BASE):
        along, s = sign * d[0], p[0] / grid.half[face]
        into = -tangent if face == TIP else tangent
    else:
        # The face is wider below the coating: both factors of a product get half of it.
        scale = 1.0 / math.sqrt(1.0 + block.kappa * depth)
    columns = grid.columns[face]
    place = 0.5 * (s + 1.0) * columns
    column = min(columns - 1, max(0, int(place)))
    xi = 2.0 * (place - column) - 1.0
    place = height * grid.rows
    row = min(grid.rows - 1, max(0, int(place)))
    zeta = 2.0 * (place - row) - 1.0
    cell = (grid.first[face] + column) * grid.rows + row
    degree = grid.degree
    powers[:, 0] = 1.0
    for i in range(degree):
        powers[0, i + 1] = powers[0, i] * along
        powers[1, i + 1] = powers[1, i] * up
    term = 0
    for part in range(2):
        for i in range(degree + 1 - part):
            for j in range(degree + 1 - part - i):
                value = scale * powers[0, i] * powers[1, j] * (into if part else 1.0)
                for weight in range(len(weights)):
                    share = value * weights[weight]
                    out[cell, term, weight] += share
                    out[cell, term + 1, weight] += share * xi
                    out[cell, term + 2, weight] += share * zeta
                    out[cell, term + 3, weight] += share * xi * zeta
                term += 4


@compiled
def trace_lamp(
    block: Block, grid: FaceGrid, origin: Array, direction: Array, weights: Array, repeats: int,
    key: int, out: Array,
) -> None:  # fmt: skip
    """Follow rays of a lamp ``(ray, 3)`` until they leave the layer, and add them to ``out``.

    Each is followed ``repeats`` times.

    ``weights`` ``(ray, node)``; ``out`` ``(cell, term, node)``. Light that enters the clear pad is
    left out. Rays of a lamp in the layer begin there.
    """
    state, powers = np.zeros(1, np.uint64), np.empty((2, grid.degree + 1))
    p, d, n, m = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    scaled = np.empty(weights.shape[1])
    for ray in range(repeats * len(origin)):
        begin_stream(state, key, ray)
        p[:] = origin[ray // repeats]
        d[:] = direction[ray // repeats]
        passed = 1.0
        if not within(block, p):
            face = enter_block(block, p, d)
            if face == NONE or block.paint[face, 0] >= 0.0:
                continue
            face_normal(block, face, p, n)
            u, v = uniform(state), uniform(state)
            passed = refract_into(block, face, block.index, d, n, u, v, m)
            if passed == 0.0:
                continue
        if not in_layer(block, p):
            continue
        left, face, scattered = walk_layer(state, block, p, d, n, m)
        if left > 0.0 and scattered >= block.wide:
            for node in range(len(scaled)):
                scaled[node] = passed * left * weights[ray // repeats, node] / repeats
            deposit(block, grid, face, p, d, 1.0, scaled, powers, out)


@compiled
def draw_point(receivers: Receivers, site: int, part: int, state: State, y: Array) -> None:
    """Set ``y`` to a point of a receiver, of even density over its triangle."""
    u, v = uniform(state), uniform(state)
    if u + v > 1.0:
        u, v = 1.0 - u, 1.0 - v
    for k in range(3):
        a = receivers.corners[site, part, 0, k]
        b = receivers.corners[site, part, 1, k]
        c = receivers.corners[site, part, 2, k]
        y[k] = a + u * (b - a) + v * (c - a)


@compiled
def receive(
    pressed: Block, receivers: Receivers, state: State, p: Array, d: Array, way: float,
    scale: float, weights: Array, received: Array, squares: Array,
) -> None:  # fmt: skip
    """Add light on its way from ``p`` along ``d`` to the receivers that it passes.

    What is added to ``received`` ``(site, receiver, weight)`` is added squared to ``squares``
    ``(weight,)``.

    ``way`` is that to the face it meets next; ``scale`` times ``weights`` ``(weight,)`` its power.
    The light is taken to be alike within ``receivers.radius``, and carried over to a point of the
    receiver, which another pyramid may hide from it.
    """
    e, y = np.empty(3), np.empty(3)
    share = 1.0 / (math.pi * receivers.radius * receivers.radius)
    for site in range(len(receivers.site)):
        along = squared = down = 0.0
        for k in range(3):
            to = receivers.site[site, k] - p[k]
            along += to * d[k]
            squared += to * to
            down += d[k] * receivers.inward[site, k]
        if down >= -1e-9 or squared - along * along > receivers.reach * receivers.reach:
            continue
        for part in range(receivers.center.shape[1]):
            cos = height = 0.0
            for k in range(3):
                cos -= receivers.normal[site, part, k] * d[k]
                height += (receivers.center[site, part, k] - p[k]) * receivers.inward[site, k]
            to = height / down
            # The coating may bend away before the plane of the receiver.
            if cos <= 0.0 or to < 0.0 or to > way + receivers.radius:
                continue
            squared = 0.0
            for k in range(3):
                off = p[k] + to * d[k] - receivers.center[site, part, k]
                squared += off * off
            if squared > receivers.radius * receivers.radius:
                continue
            if receivers.shaded[part]:
                draw_point(receivers, site, part, state, y)
                for k in range(3):
                    e[k] = -d[k]
                _, hidden, _ = meet_pyramids(pressed, y, e, to)
                if hidden >= 0:
                    continue
            factor = scale * share * cos / -down
            sights = receivers.sights.shape[2]
            if sights > 0:
                sight = min(sights - 1, int(uniform(state) * sights))
                seen, normal = receivers.sights[site, part, sight], receivers.normal[site, part]
                factor *= sent_to(pressed, d, seen, normal)
            for weight in range(len(weights)):
                added = factor * weights[weight]
                received[site, part, weight] += added
                squares[weight] += added * added


@compiled
def receive_along_bend(
    pressed: Block, receivers: Receivers, state: State, p: Array, d: Array, way: float,
    scale: float, weights: Array, received: Array, squares: Array,
) -> None:  # fmt: skip
    """Do as `receive` in a bent pad, whose coating is convex seen from within.

    Light is taken to be alike under motions along the coating: a rotation about the bend's axis and
    a shift across. So it is carried over to a point of the receiver from where its ray is as deep
    below the coating, in the same direction relative to it. Light that skims the coating is that
    deep twice, and meets pyramids on its way off the coating, too.
    """
    e, y = np.empty(3), np.empty(3)
    share = 1.0 / (math.pi * receivers.radius * receivers.radius)
    faces, axis = pressed.normal.shape[1], 1.0 / pressed.kappa
    across = d[1] * d[1] + d[2] * d[2]
    if across < 1e-12:
        return
    nearing = (p[1] * d[1] + (p[2] + axis) * d[2]) / across
    reach = receivers.reach + receivers.radius
    for site in range(len(receivers.site)):
        along = squared = 0.0
        for k in range(3):
            to = receivers.site[site, k] - p[k]
            along += to * d[k]
            squared += to * to
        if squared - along * along > reach * reach or along < -reach or along > way + reach:
            continue
        for part in range(receivers.center.shape[1]):
            draw_point(receivers, site, part, state, y)
            # Chords of the coating lie a hair beyond it.
            level = max(level_of(pressed, y), 0.0)
            radius = math.hypot(y[1], y[2] + axis)
            sin, cos = y[1] / radius, (y[2] + axis) / radius
            over = 2.0 * axis * (level_of(pressed, p) - level) / across
            root = nearing * nearing - over
            if root <= 0.0:
                continue
            root = math.sqrt(root)
            for sign in (-1.0, 1.0):
                to = -nearing + sign * root
                if to < 0.0 or to > way + BLOCK_TOLERANCE:
                    continue
                x = p[0] + to * d[0] - y[0]
                q, r = p[1] + to * d[1], p[2] + axis + to * d[2]
                # The angle about the axis from there to the receiver's point.
                turned_sin = (r * sin - q * cos) / radius
                turned_cos = (r * cos + q * sin) / radius
                arc = radius * math.atan2(turned_sin, turned_cos)
                if x * x + arc * arc > receivers.radius * receivers.radius:
                    continue
                e[0] = d[0]
                e[1] = d[1] * turned_cos + d[2] * turned_sin
                e[2] = d[2] * turned_cos - d[1] * turned_sin
                down = -(e[1] * sin + e[2] * cos)
                facing = down
                if part < faces:
                    facing = 0.0
                    for k in range(3):
                        facing -= receivers.normal[site, part, k] * e[k]
                if facing <= 0.0 or abs(down) < SKIMMING:
                    continue
                factor = scale * share * facing / abs(down)
                sights = receivers.sights.shape[2]
                if sights > 0:
                    sight = min(sights - 1, int(uniform(state) * sights))
                    seen, normal = receivers.sights[site, part, sight], receivers.normal[site, part]
                    factor *= sent_to(pressed, e, seen, normal)
                if receivers.shaded[part]:
                    for k in range(3):
                        e[k] = -e[k]
                    _, hidden, _ = meet_pyramids(pressed, y, e, to)
                    if hidden >= 0:
                        continue
                for weight in range(len(weights)):
                    added = factor * weights[weight]
                    received[site, part, weight] += added
                    squares[weight] += added * added


@compiled
def receive_from_coating(
    pressed: Block, receivers: Receivers, p: Array, d: Array, scale: float, weights: Array,
    received: Array, squares: Array,
) -> None:  # fmt: skip
    """Add light that leaves the coating at ``p`` along ``d`` to the facet that it meets, if any.

    It has gone by where `receive` looks, and what the coating's lobe sends to pyramids beside it
    is little: this counts it as it arrives. Arguments and results as there.
    """
    _, site, facet = meet_pyramids(pressed, p, d, math.inf)
    if site < 0:
        return
    sights = receivers.sights.shape[2]
    for index in range(len(receivers.site)):
        apart = 0.0
        for k in range(3):
            apart += abs(receivers.site[index, k] - pressed.sites[site, k])
        if apart > 1e-6:
            continue
        corners, normal = receivers.corners[index, facet], pressed.normal[site, facet]
        area = 0.5 * np.linalg.norm(np.cross(corners[1] - corners[0], corners[2] - corners[0]))
        mean = 0.0
        for sight in range(sights):
            mean += sent_to(pressed, d, receivers.sights[index, facet, sight], normal) / sights
        for weight in range(len(weights)):
            added = scale * mean / area * weights[weight]
            received[index, facet, weight] += added
            squares[weight] += added * added


@compiled
def trace_arrivals(
    block: Block, pressed: Block, receivers: Receivers, origin: Array, direction: Array,
    weights: Array, key: int, number: int, patches: Array, received: Array, squares: Array,
) -> None:  # fmt: skip
    """Follow rays of a lamp ``(ray, 3)`` until they end on the coating of the untouched ``block``.

    A lobe of the coating sends them on. But for light that belongs to the exit field: it ends where
    it leaves the layer. Rays of a lamp in the block begin there.

    ``weights`` ``(ray, node)``; ``number`` is that of the first ray. The power that
    arrives is added to ``patches`` ``(patch, node)``, and the irradiance of receivers to
    ``received`` ``(site, receiver, node)``, see `receive`.
    """
    state = np.zeros(1, np.uint64)
    p, d, n, m = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for ray in range(len(origin)):
        begin_stream(state, key, number + ray)
        p[:] = origin[ray]
        d[:] = direction[ray]
        weight, below, most = 1.0, p[2] > block.bond, MAX_EVENTS
        if within(block, p):
            most = TRAPPED_EVENTS
            layer = in_layer(block, p)
        else:
            face = enter_block(block, p, d)
            if face == NONE:
                continue
            layer = in_layer(block, p)
            if block.paint[face, 0] >= 0.0 or (face == UPPER and not layer):
                continue  # on the back of paint or coating
            face_normal(block, face, p, n)
            below, u, v = p[2] > block.bond, uniform(state), uniform(state)
            weight = refract_into(block, face, index_of(block, below), d, n, u, v, m)
        if weight > 0.0 and layer:
            left, face, scattered = walk_layer(state, block, p, d, n, m)
            weight *= left if scattered < block.wide else 0.0
        trapped = 0
        for _ in range(MAX_EVENTS):
            trapped = trapped + 1 if below else 0
            if weight == 0.0 or trapped > most:
                break
            way, face, _, _ = cross_clear(block, below, p, d)
            if block.kappa > 0.0:
                receive_along_bend(
                    pressed, receivers, state, p, d, way, weight, weights[ray], received, squares
                )
            elif not below:
                receive(
                    pressed, receivers, state, p, d, way, weight, weights[ray], received, squares
                )
            for k in range(3):
                p[k] += way * d[k]
            if face == COATING:
                patch = patch_of(block, p)
                for node in range(weights.shape[1]):
                    patches[patch, node] += weight * weights[ray, node]
                if block.skin[1] == 0.0 or uniform(state) >= block.skin[1]:
                    break
                face_normal(block, LOWER, p, n)
                weight *= reflect_lobe(block, d, n, uniform(state), uniform(state), m)
                if weight > 0.0:
                    receive_from_coating(
                        pressed, receivers, p, d, weight, weights[ray], received, squares
                    )
                continue
            if face == BOND:
                below = meet_bond(block, below, d, uniform(state))
            elif face <= BASE and block.rims[face] > 0.0:
                left, face, _ = walk_layer(state, block, p, d, n, m)
                weight *= left
            else:
                face_normal(block, face, p, n)
                for k in range(3):
                    n[k] = -n[k]
                u, v, chance = uniform(state), uniform(state), uniform(state)
                index = index_of(block, below)
                weight *= reflect_inside(block, face, index, d, n, u, v, chance, m)


@compiled
def find_coating(
    block: Block, origin: Array, direction: Array, points: Array, normals: Array, weights: Array
) -> None:
    """Write where rays ``(ray, 3)`` in the pad meet the coating: point, normal into the pad.

    Rays begin above a window. Weights ``(ray,)`` become 1, or 0 where a ray meets something else
    first.
    """
    p, d = np.empty(3), np.empty(3)
    for ray in range(len(origin)):
        p[:] = origin[ray]
        d[:] = direction[ray]
        way, face, site, facet = cross_clear(block, False, p, d)
        weights[ray] = 1.0 if face in (COATING, FACET) else 0.0
        for k in range(3):
            points[ray, k] = p[k] + way * d[k]
        if face == FACET:
            normals[ray] = block.normal[site, facet]
        else:
            face_normal(block, LOWER, points[ray], normals[ray])


@compiled
def gather(
    block: Block, grid: FaceGrid, points: Array, normals: Array, sights: Array, weights: Array,
    drawn: Array, key: int, out: Array, patches: Array,
) -> None:  # fmt: skip
    """Follow light backwards from points of the coating ``(path, 3)`` to the layer and to itself.

    Directions at the points are cosine distributed; ``drawn`` ``(path, 5)`` in [0, 1) draws them
    and the first reflection. With lines of sight ``(path, 3)`` onto the points (else none) they
    are those of the coating and its lobe. Where a path enters the layer, the light that leaves
    there is added to ``out`` ``(cell, term, 1)``, which may have no cells; where it meets the
    coating, its weight to ``patches`` ``(patch,)``. There it ends, unless the lobe sends it on.
    """
    state, powers, one = np.zeros(1, np.uint64), np.empty((2, grid.degree + 1)), np.empty(1)
    p, d, n, m = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for path in range(len(points)):
        weight = weights[path]
        if weight == 0.0:
            continue
        begin_stream(state, key, path)
        p[:] = points[path]
        d[:] = normals[path]
        if len(sights) == 0:
            turn(d, math.sqrt(1.0 - drawn[path, 0]), 2.0 * math.pi * drawn[path, 1])
        else:
            share, u = block.skin[1] / (block.skin[0] + block.skin[1]), drawn[path, 0]
            if u < share:
                d[:] = sights[path]
                weight *= reflect_lobe(block, d, normals[path], u / share, drawn[path, 1], m)
                if weight == 0.0:
                    continue
            else:
                u = (u - share) / (1.0 - share)
                turn(d, math.sqrt(1.0 - u), 2.0 * math.pi * drawn[path, 1])
        first, below = True, False
        for _ in range(MAX_EVENTS):
            way, face, site, facet = cross_clear(block, below, p, d)
            for k in range(3):
                p[k] += way * d[k]
            if face in (COATING, FACET):
                patches[patch_of(block, p)] += weight
                if block.skin[1] == 0.0 or uniform(state) >= block.skin[1]:
                    break
                if face == FACET:
                    n[:] = block.normal[site, facet]
                else:
                    face_normal(block, LOWER, p, n)
                weight *= reflect_lobe(block, d, n, uniform(state), uniform(state), m)
                if weight == 0.0:
                    break
                continue
            if face == BOND:
                below = meet_bond(block, below, d, uniform(state))
            elif face <= BASE and block.rims[face] > 0.0:
                if len(out):
                    one[0] = weight
                    deposit(block, grid, face, p, d, -1.0, one, powers, out)
                left, face, _ = walk_layer(state, block, p, d, n, m)
                weight *= left
            else:
                face_normal(block, face, p, n)
                for k in range(3):
                    n[k] = -n[k]
                if first:
                    u, v, chance = drawn[path, 2], drawn[path, 3], drawn[path, 4]
                else:
                    u, v, chance = uniform(state), uniform(state), uniform(state)
                index = index_of(block, below)
                weight *= reflect_inside(block, face, index, d, n, u, v, chance, m)
                first = False
            if weight == 0.0:
                break
