"""Light followed from lamps to the coating, and what receivers get of it as it passes.

Photons are analog but for masking at rough faces, and end on the coating unless its lobe sends them
on. A receiver counts what passes within a disk about it, over the disk's area.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from render.arrays import Array
from render.compiled import compiled, inlined
from render.preview.converged.walks.crossings import (
    BASE,
    BLOCK_TOLERANCE,
    BOND,
    COATING,
    NONE,
    UPPER,
    Block,
    coating_normal,
    cross_clear,
    enter_block,
    face_normal,
    in_layer,
    level_of,
    meet_pyramids,
    patch_of,
    within,
)
from render.preview.converged.walks.faces import (
    index_of,
    meet_bond,
    reflect_inside,
    reflect_lobe,
    refract_into,
    sent_to,
)
from render.preview.converged.walks.layer import MAX_EVENTS, walk_layer
from render.preview.converged.walks.splitmix import State, begin_stream, uniform

TRAPPED_EVENTS = 500
"""Faces of a window that light of a lamp in it meets in a row, after which it is taken to be lost:
between smooth faces much of it circles without loss."""
SKIMMING = 1e-3
"""Sine of the angle to a bent coating below which light is left out where it is received."""


class Receivers(NamedTuple):
    """Small faces at the sites that gather the light which passes near them; mm.

    Arguments:
        site: ``(site, 3)`` where each site touches the coating; ``inward`` ``(site, 3)`` the unit
            normal of the coating there, into the pad.
        center, normal: ``(site, receiver, 3)``; normals are unit and point into the pad.
        corners: ``(site, receiver, 3, 3)`` of a triangle on which shadows are looked for.
        shaded: ``(receiver,)`` whether pyramids hide light from it.
        radius: ``(receiver,)`` of the disk parallel to the coating, about the center, over which
            light is taken to be alike.
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
    radius: Array
    reach: float
    sights: Array


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


@inlined
def add_light(received: Array, squares: Array, factor: float, weights: Array) -> None:
    """Add ``factor`` times ``weights`` to ``received``; and to ``squares``, squared."""
    for weight in range(len(weights)):
        added = factor * weights[weight]
        received[weight] += added
        squares[weight] += added * added


@inlined
def receive(
    pressed: Block, receivers: Receivers, state: State, p: Array, d: Array, way: float,
    free: bool, scale: float, weights: Array, received: Array, squares: Array, e: Array, y: Array,
) -> None:  # fmt: skip
    """Add light on its way from ``p`` along ``d`` to the receivers that it passes.

    What is added to ``received`` ``(site, receiver, weight)`` is added squared to ``squares``
    ``(weight,)``.

    ``way`` is that to the face it meets next; ``scale`` times ``weights`` ``(weight,)`` its power.
    The light is taken to be alike within ``receivers.radius``, and carried over to a point of the
    receiver, which another pyramid may hide from it; where it is not ``free``, one has ended it
    before. It meets pyramids from above as well as from below. ``e`` and ``y`` ``(3,)`` are
    scratch.
    """
    for site in range(len(receivers.site)):
        along = squared = down = 0.0
        for k in range(3):
            to = receivers.site[site, k] - p[k]
            along += to * d[k]
            squared += to * to
            down += d[k] * receivers.inward[site, k]
        if abs(down) < 1e-9 or squared - along * along > receivers.reach * receivers.reach:
            continue
        for part in range(receivers.center.shape[1]):
            if receivers.shaded[part] and not free:
                continue
            cos = height = 0.0
            for k in range(3):
                cos -= receivers.normal[site, part, k] * d[k]
                height += (receivers.center[site, part, k] - p[k]) * receivers.inward[site, k]
            to = height / down
            radius = receivers.radius[part]
            # The coating may bend away before the plane of the receiver.
            if cos <= 0.0 or to < 0.0 or to > way + radius:
                continue
            squared = 0.0
            for k in range(3):
                off = p[k] + to * d[k] - receivers.center[site, part, k]
                squared += off * off
            if squared > radius * radius:
                continue
            if receivers.shaded[part]:
                draw_point(receivers, site, part, state, y)
                for k in range(3):
                    e[k] = -d[k]
                _, hidden, _ = meet_pyramids(pressed, y, e, to)
                if hidden >= 0:
                    continue
            factor = scale / (math.pi * radius * radius) * cos / abs(down)
            sights = receivers.sights.shape[2]
            if sights > 0:
                sight = min(sights - 1, int(uniform(state) * sights))
                seen, normal = receivers.sights[site, part, sight], receivers.normal[site, part]
                factor *= sent_to(pressed, d, seen, normal)
            add_light(received[site, part], squares, factor, weights)


@inlined
def receive_along_bend(
    pressed: Block, receivers: Receivers, state: State, p: Array, d: Array, way: float,
    free: bool, scale: float, weights: Array, received: Array, squares: Array, e: Array, y: Array,
) -> None:  # fmt: skip
    """Do as `receive` in a bent pad, whose coating is convex seen from within.

    Light is taken to be alike under motions along the coating: a rotation about the bend's axis and
    a shift across. So it is carried over to a point of the receiver from where its ray is as deep
    below the coating, in the same direction relative to it. Light that skims the coating is that
    deep twice, and meets pyramids on its way off the coating, too.
    """
    faces, axis = pressed.normal.shape[1], 1.0 / pressed.kappa
    across = d[1] * d[1] + d[2] * d[2]
    if across < 1e-12:
        return
    nearing = (p[1] * d[1] + (p[2] + axis) * d[2]) / across
    reach = receivers.reach + receivers.radius.max()
    for site in range(len(receivers.site)):
        along = squared = 0.0
        for k in range(3):
            to = receivers.site[site, k] - p[k]
            along += to * d[k]
            squared += to * to
        if squared - along * along > reach * reach or along < -reach or along > way + reach:
            continue
        for part in range(receivers.center.shape[1]):
            if receivers.shaded[part] and not free:
                continue
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
                wide = receivers.radius[part]
                if x * x + arc * arc > wide * wide:
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
                factor = scale / (math.pi * wide * wide) * facing / abs(down)
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
                add_light(received[site, part], squares, factor, weights)


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
    e, y = np.empty(3), np.empty(3)
    for ray in range(len(origin)):
        begin_stream(state, key, number + ray)
        for k in range(3):
            p[k], d[k] = origin[ray, k], direction[ray, k]
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
        trapped, free = 0, True
        for _ in range(MAX_EVENTS):
            trapped = trapped + 1 if below else 0
            if weight == 0.0 or trapped > most:
                break
            way, face, _, _ = cross_clear(block, below, p, d)
            if block.kappa > 0.0:
                receive_along_bend(
                    pressed, receivers, state, p, d, way, free, weight, weights[ray], received,
                    squares, e, y,
                )  # fmt: skip
            elif not below:
                receive(
                    pressed, receivers, state, p, d, way, free, weight, weights[ray], received,
                    squares, e, y,
                )  # fmt: skip
            if free and not below:
                _, met, _ = meet_pyramids(pressed, p, d, way)
                free = met < 0
            for k in range(3):
                p[k] += way * d[k]
            if face == COATING:
                patch = patch_of(block, p)
                for node in range(weights.shape[1]):
                    patches[patch, node] += weight * weights[ray, node]
                if block.skin[1] == 0.0 or uniform(state) >= block.skin[1]:
                    break
                coating_normal(block, p, n)
                weight *= reflect_lobe(block, d, n, uniform(state), uniform(state), m)
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
