"""The bent block as a solid, and where a ray meets the faces of its parts.

The frame is that of `render.preview.converged.walks`. Every face is a plane or a quadric, so the
way to it has a closed form, but for a skin that is not flat (`way_to_skin`). Lengths in mm, points
and unit directions ``(3,)``.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from render.arrays import Array
from render.compiled import inlined

(
    LEFT, TIP, RIGHT, BASE, COATING, FACET, LOWER, UPPER, START, END, OUTER_LEFT, OUTER_RIGHT, BOND,
    NONE,
) = range(14)  # fmt: skip
"""Faces; the first four are the edges of the clear pad. Where a layer lies on one light passes
straight, and meets an outer one behind it."""
BLOCK_TOLERANCE = 1e-7
"""mm by which rounding may move a point out of the block."""
SKIN_STEPS, ON_SKIN = 100, 1e-7
"""Steps of a ray to a coating that is no plane at most, and mm below it that are on it."""


class Block(NamedTuple):
    """What light moves in; lengths in mm, coefficients in 1/mm, the frame of this room.

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
        sag: ``(row, column, 3)`` on an even grid over the clear pad: depth of a flat pad's coating
            under its crown and its slopes along x and y; empty where it is a plane.
        sinks: ``(2,)`` the largest depth in ``sag``, and the largest curvature downwards, 1/mm.
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
    sag: Array
    sinks: Array


@inlined
def beyond(plane: Array, p: Array) -> float:
    """Return how far (mm) a point lies towards the tip from a plane through the axis."""
    return float(plane[0] * p[1] - plane[1] * p[2] - plane[2])


@inlined
def way_to(plane: Array, p: Array, d: Array, sign: float) -> float:
    """Return the way (mm) to a plane through the axis that is passed towards the tip (1) or base.

    ``sign`` is -1 for the base; infinite where ``d`` leads the other way.
    """
    towards = plane[0] * d[1] - plane[1] * d[2]
    return -beyond(plane, p) / towards if sign * towards > 0.0 else math.inf


@inlined
def sag_at(block: Block, x: float, y: float) -> tuple[float, float, float]:
    """Return depth and slopes along x and y of a coating that is no plane, bilinear on its grid.

    Outside of the pad they are those at its edge.
    """
    rows, columns = block.sag.shape[0], block.sag.shape[1]
    half_length = block.patch[2]
    y += block.patch[3]  # the pivot
    across = min(max(0.5 * (x / block.half_width + 1.0), 0.0), 1.0) * (columns - 1)
    along = min(max(0.5 * (y / half_length + 1.0), 0.0), 1.0) * (rows - 1)
    i, j = min(int(across), columns - 2), min(int(along), rows - 2)
    u, v = across - i, along - j
    low_left, low_right = (1.0 - u) * (1.0 - v), u * (1.0 - v)
    high_left, high_right = (1.0 - u) * v, u * v
    a, b, c, d = block.sag[j, i], block.sag[j, i + 1], block.sag[j + 1, i], block.sag[j + 1, i + 1]
    return (
        low_left * a[0] + low_right * b[0] + high_left * c[0] + high_right * d[0],
        low_left * a[1] + low_right * b[1] + high_left * c[1] + high_right * d[1],
        low_left * a[2] + low_right * b[2] + high_left * c[2] + high_right * d[2],
    )


@inlined
def way_to_skin(block: Block, p: Array, d: Array, limit: float) -> float:
    """Return the way (mm) from within the pad to a coating that is no plane, or ``limit``.

    Steps are as long as the coating's largest curvature allows: none passes through it, and on a
    sphere or cylinder the second or third is on it.
    """
    end = p[2] + limit * d[2]
    if p[2] > block.sinks[0] and end > block.sinks[0]:
        return limit
    way = 0.0
    if p[2] > block.sinks[0]:
        way = (block.sinks[0] - p[2]) / d[2]
    bend = block.sinks[1] * (d[0] * d[0] + d[1] * d[1])
    for _ in range(SKIN_STEPS):
        depth, along_x, along_y = sag_at(block, p[0] + way * d[0], p[1] + way * d[1])
        # Room to the coating, straight up, and how it grows along the ray.
        room = max(p[2] + way * d[2] - depth, 0.0)
        grows = d[2] - along_x * d[0] - along_y * d[1]
        if room < ON_SKIN and grows <= 0.0:
            return min(way, limit)
        # The first root of room + grows s - bend s^2 / 2.
        root = math.sqrt(grows * grows + 2.0 * bend * room)
        if grows < 0.0:
            step = 2.0 * room / (root - grows)
        else:
            step = (grows + root) / bend if bend > 0.0 else math.inf
        way += step
        if way >= limit:
            return limit
    return min(way, limit)


@inlined
def level_of(block: Block, p: Array) -> float:
    """Return the level g of a point."""
    return float(0.5 * block.kappa * (p[1] * p[1] + p[2] * p[2]) + p[2])


@inlined
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


@inlined
def coating_normal(block: Block, p: Array, n: Array) -> None:
    """Write the unit normal into the pad of the untouched coating at ``p``."""
    n[0], n[1], n[2] = 0.0, block.kappa * p[1], block.kappa * p[2] + 1.0
    if len(block.sag):
        _, along_x, along_y = sag_at(block, p[0], p[1])
        n[0], n[1] = -along_x, -along_y
    scale = 1.0 / math.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
    for k in range(3):
        n[k] *= scale


@inlined
def face_normal(block: Block, face: int, p: Array, n: Array) -> None:
    """Write the unit normal out of the block of a face to the air at ``p``."""
    n[0], n[1], n[2] = 0.0, 0.0, 0.0
    if face in (LOWER, UPPER):
        n[1], n[2] = block.kappa * p[1], block.kappa * p[2] + 1.0
        scale = (1.0 if face == LOWER else -1.0) / math.sqrt(n[1] * n[1] + n[2] * n[2])
        for k in range(3):
            n[k] *= scale
    elif face in (START, BASE):
        n[1], n[2] = -block.base[0], block.base[1]
    elif face in (END, TIP):
        n[1], n[2] = block.end[0], -block.end[1]
    else:
        n[0] = -1.0 if face in (OUTER_LEFT, LEFT) else 1.0


@inlined
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


@inlined
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
    if len(block.sag):
        before = way_to_skin(block, p, d, way)
        if before < way:
            way, face = before, COATING
    if len(block.sites):
        # As far as the lower face may reach, a pyramid is met first or not at all.
        before, site, facet = meet_pyramids(block, p, d, way)
        if site >= 0:
            return before, FACET, site, facet
    return way, face, -1, -1


@inlined
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


@inlined
def within(block: Block, p: Array) -> bool:
    """Return whether the block holds a point, but for rounding."""
    level = level_of(block, p)
    top = sag_at(block, p[0], p[1])[0] if len(block.sag) else 0.0
    return (
        p[0] <= block.half_width + block.rims[RIGHT] + BLOCK_TOLERANCE
        and -p[0] <= block.half_width + block.rims[LEFT] + BLOCK_TOLERANCE
        and beyond(block.start, p) >= -BLOCK_TOLERANCE
        and beyond(block.end, p) <= BLOCK_TOLERANCE
        and level >= top - BLOCK_TOLERANCE
        and level <= block.level + BLOCK_TOLERANCE
    )


@inlined
def enter_block(block: Block, p: Array, d: Array) -> int:
    """Move a point in the air on to where its ray enters the block; return the face, or NONE.

    The upper face is met from above its level alone: NONE for light that begins below that level
    beyond an end of a bent block, and comes over the end onto it.
    """
    best, found = math.inf, NONE
    start = p[0], p[1], p[2]
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
                p[k] += to * d[k]
            if within(block, p):
                best, found = to, face
            p[0], p[1], p[2] = start
    if found != NONE:
        for k in range(3):
            p[k] += best * d[k]
    return found


@inlined
def in_layer(block: Block, p: Array) -> bool:
    """Return whether a point of the block lies in the diffusive layer."""
    return (
        (block.rims[LEFT] > 0.0 and -p[0] > block.half_width)
        or (block.rims[RIGHT] > 0.0 and p[0] > block.half_width)
        or (block.rims[TIP] > 0.0 and beyond(block.tip, p) > 0.0)
        or (block.rims[BASE] > 0.0 and beyond(block.base, p) < 0.0)
    )


@inlined
def angle_of(block: Block, p: Array) -> tuple[float, float, float]:
    """Return sine and cosine of the local frame's turn at a point, and its flat ``v``."""
    y, w = block.kappa * p[1], 1.0 + block.kappa * p[2]
    scale = 1.0 / math.sqrt(y * y + w * w)
    flat = math.atan2(y, w) / block.kappa if block.kappa > 0.0 else p[1]
    return y * scale, w * scale, flat


@inlined
def patch_of(block: Block, p: Array) -> int:
    """Return the number of the coating's patch above a point."""
    columns, rows = int(block.patch[0]), int(block.patch[1])
    _, _, flat = angle_of(block, p)
    y = (flat + block.patch[3]) / block.patch[2]
    column = min(columns - 1, max(0, int(0.5 * (p[0] / block.half_width + 1.0) * columns)))
    row = min(rows - 1, max(0, int(0.5 * (y + 1.0) * rows)))
    return row * columns + column
