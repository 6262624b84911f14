"""Where the way from a point of a pad to a lamp crosses its face, and the bond of a window.

At one face Snell's law is an equation of one unknown. Over a bond light is refracted twice, in
planes at right angles, so both crossings are unknown at once. By Fermat's principle they are those
of the shortest optical path: the sum of three lengths, each times its index, is convex in the
crossings, and Newton's method finds its minimum.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

STEPS = 14
"""Steps of Newton's method: 99 % of crossings miss Snell's law by less than 1e-5 then."""
LENGTHS = (1.0, 0.4, 0.1)
"""Of a step, tried in turn: a sum of lengths is nearly linear far from its minimum."""
NEAR = 0.05**2
"""Squared step (mm^2) up to which one is taken as it is."""
SHORTEST = 1e-3
"""mm that each part of a way has at least."""


def face_crossing(
    reach: mi.Float, inside: mi.Float, outside: mi.Float, index: mi.Float | float,
    critical: mi.Float, steps: int,
) -> mi.Float:  # fmt: skip
    """Return how far from the foot of the perpendicular a line of Snell's law crosses a face.

    The distances (mm) of its ends from the face are ``inside`` and ``outside``, along it ``reach``;
    ``critical`` is how far total reflection lets it go. Newton's method, from the paraxial ray.
    """
    lateral = dr.minimum(reach * inside / (inside + index * outside), critical)
    for _ in range(steps):
        rest = reach - lateral
        near = dr.rsqrt(dr.square(lateral) + dr.square(inside))
        distant = dr.rsqrt(dr.square(rest) + dr.square(outside))
        excess = index * lateral * near - rest * distant
        slope_in = index * dr.square(inside) * near * near * near
        slope_out = dr.square(outside) * distant * distant * distant
        lateral = dr.clip(lateral - excess / (slope_in + slope_out), 0.0, reach)
    return lateral


@dataclass
class Crossings:
    """Where a way crosses bond and outer face (a Dr.Jit PyTree), with its optical length (mm)."""

    bond: mi.Vector3f
    face: mi.Vector3f
    length: mi.Float


@dr.syntax
def shortest_way(
    a: mi.Vector3f, layer: mi.Float, layer_index: mi.Float, rises: mi.Bool, foot: mi.Vector3f,
    inward: mi.Vector3f, lamp: mi.Vector3f, index: mi.Float,
) -> Crossings:  # fmt: skip
    """Return where the way from ``a`` to a ``lamp`` behind the face at ``foot`` crosses.

    First comes a layer of ``layer`` mm and ``layer_index``, above ``a`` where the way ``rises``,
    and then one of ``index`` up to the face with the normal ``inward``.
    """
    up = dr.select(rises, 1.0, -1.0)
    level = a.z + up * layer
    first, second = mi.coordinate_system(inward)
    # The second layer lies behind the first, if there is one.
    least = dr.select(layer > SHORTEST, SHORTEST, -dr.inf)
    # Start: straight at the foot of the lamp.
    face = lamp - dr.dot(lamp - foot, inward) * inward
    face.z = level + up * dr.maximum(up * (face.z - level), least)
    part = layer / dr.maximum(layer + dr.abs(face.z - level), SHORTEST)
    bond = a + part * (face - a)
    bond.z = level
    here = Crossings(bond, face, _length(a, bond, face, lamp, layer_index, index))
    step = mi.UInt32(0)
    while step < STEPS:
        inverse, slope = _derivatives(a, here, lamp, layer_index, index, (first, second))
        by = inverse @ slope
        over, along = mi.Vector3f(by[0], by[1], 0.0), by[2] * first + by[3] * second
        # Half way to the bond at most, where the second layer would end.
        room = dr.select(layer > SHORTEST, up * (here.face.z - level), dr.inf)
        whole = dr.minimum(1.0, 0.5 * room / dr.maximum(up * along.z, 1e-9))
        # Of near minima lengths tell little.
        near = (dr.squared_norm(by) < NEAR) & (whole == 1.0)
        best = here
        for part_of in LENGTHS:
            bond, face = here.bond - part_of * whole * over, here.face - part_of * whole * along
            other = Crossings(bond, face, _length(a, bond, face, lamp, layer_index, index))
            better = other.length < best.length
            best = dr.select(dr.select(near, part_of == 1.0, better), other, best)
        here = best
        step += 1
    return here


def _unit(span: mi.Vector3f) -> tuple[mi.Vector3f, mi.Float]:
    """Return direction and length of ``span``, which is `SHORTEST` at least."""
    length = dr.maximum(dr.norm(span), SHORTEST)
    return span / length, length


def _length(
    a: mi.Vector3f, bond: mi.Vector3f, face: mi.Vector3f, lamp: mi.Vector3f,
    layer_index: mi.Float, index: mi.Float,
) -> mi.Float:  # fmt: skip
    """Return the optical length of a way."""
    return layer_index * dr.norm(bond - a) + index * dr.norm(face - bond) + dr.norm(lamp - face)


def _derivatives(
    a: mi.Vector3f, at: Crossings, lamp: mi.Vector3f, layer_index: mi.Float, index: mi.Float,
    in_face: tuple[mi.Vector3f, mi.Vector3f],
) -> tuple[mi.Matrix4f, mi.Vector4f]:  # fmt: skip
    """Return the inverse of the second derivatives of the optical length, and the first ones.

    By x and y at the bond, then along both directions ``in_face``.
    """
    u, before = _unit(at.bond - a)
    v, between = _unit(at.face - at.bond)
    t, after = _unit(lamp - at.face)
    x, y = mi.Vector3f(1.0, 0.0, 0.0), mi.Vector3f(0.0, 1.0, 0.0)
    along = (x, y, *in_face)
    at_bond, at_face = layer_index * u - index * v, index * v - t
    slope = mi.Vector4f(at_bond.x, at_bond.y, *(dr.dot(at_face, each) for each in in_face))
    bent, passed, outside = layer_index / before, index / between, dr.rcp(after)

    def curved(weight: mi.Float, d: mi.Vector3f, i: int, j: int) -> mi.Float:
        return weight * (dr.dot(along[i], along[j]) - dr.dot(along[i], d) * dr.dot(along[j], d))

    rows = []
    for i in range(4):
        row = []
        for j in range(4):
            both = curved(passed, v, i, j)
            if (i < 2) != (j < 2):
                row.append(-both)
            elif i < 2:
                row.append(both + curved(bent, u, i, j))
            else:
                row.append(both + curved(outside, t, i, j))
        rows.append(row)
    return dr.rcp(mi.Matrix4f(rows)), slope
