"""What a smooth bond of pad and window does to light on its way between skin, window and lamps.

Along the faces wave vectors stay, so the order of layers does not matter to where a way ends, and
unfolded over walls and lower face it is one line that is bent at the bond. ``ratio`` is the index
of the window over that of the pad. Cosines are those to the bond's normal, z.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from render.cells.crossings import face_crossing
from render.scene import Scene

STEPS = 8
"""Of Newton's method."""
THINNEST = 1e-4
"""mm that either medium has at least on a way."""


def through_bond(d: mi.Vector3f, ratio: mi.Float) -> tuple[mi.Vector3f, mi.Float]:
    """Return the direction of light along ``d`` behind the bond, and what passes it."""
    down = d.z < 0
    scale = dr.select(down, dr.rcp(ratio), ratio)
    along = dr.square(scale) * (1.0 - dr.square(d.z))
    rise = dr.mulsign(dr.sqrt(dr.maximum(1.0 - along, 0.0)), d.z)
    cosine = dr.select(down, dr.abs(d.z), -dr.abs(d.z))
    return mi.Vector3f(scale * d.x, scale * d.y, rise), 1.0 - mi.fresnel(cosine, ratio)[0]


class WindowBond:
    """The bond of a flat pad and a window of another index, at z = 0.

    Both indices, their ``ratio`` and the window's ``thickness`` (mm).
    """

    def __init__(self, scene: Scene) -> None:
        """Take them from the scene."""
        assert scene.window is not None
        pad, window = scene.pad.index, scene.window.index
        self.window_is_denser = window > pad
        self.pad, self.window, self.ratio = mi.Float(pad), mi.Float(window), mi.Float(window / pad)
        self.thickness = mi.Float(scene.window.thickness)
        dr.make_opaque(self.pad, self.window, self.ratio, self.thickness)

    def index_at(self, p: mi.Point3f) -> mi.Float:
        """Return the index at a point of pad or window."""
        return dr.select(p.z < 0.0, self.window, self.pad)

    def window_cos(self, pad_cos: mi.Float) -> mi.Float:
        """Return the cosine in the window of light with that in the pad."""
        along = (1.0 - dr.square(pad_cos)) / dr.square(self.ratio)
        return dr.sqrt(dr.maximum(1.0 - along, 0.0))

    def passed(self, pad_cos: mi.Float) -> mi.Float:
        """Return what the bond lets through; the cosine is that in the pad."""
        return 1.0 - mi.fresnel(dr.abs(pad_cos), self.ratio)[0]


@dataclass
class LayeredWay:
    """A way through pad and window, and perhaps back (a Dr.Jit PyTree).

    ``direction`` (downwards), ``pad_cos`` and ``pad_length`` (mm) are in the pad, ``window_cos``
    and ``window_length`` in the window. ``spread`` is the area across the way in the pad per solid
    angle there (mm^2 / sr).
    """

    direction: mi.Vector3f
    pad_cos: mi.Float
    window_cos: mi.Float
    pad_length: mi.Float
    window_length: mi.Float
    spread: mi.Float


def way_through_bond(
    bond: WindowBond, across: mi.Vector3f, pad: mi.Float, window: mi.Float
) -> LayeredWay:
    """Return the way that goes as far as x and y of ``across`` (mm).

    It crosses heights ``pad`` of silicone and ``window`` of the window in all (mm).
    """
    ratio, window_is_denser = bond.ratio, bond.window_is_denser
    reach = dr.maximum(dr.hypot(across.x, across.y), 1e-6)
    pad, window = dr.maximum(pad, THINNEST), dr.maximum(window, THINNEST)
    # From the denser side total reflection says where the crossing is at most.
    if window_is_denser:
        first, second, denser = window, pad, ratio
    else:
        first, second, denser = pad, window, dr.rcp(ratio)
    critical = first * dr.rsqrt(dr.maximum(dr.square(denser) - 1.0, 1e-6))
    lateral = face_crossing(reach, first, second, denser, critical, STEPS)
    by_pad = reach - lateral if window_is_denser else lateral
    by_window = reach - by_pad
    pad_length, window_length = dr.hypot(by_pad, pad), dr.hypot(by_window, window)
    cos_1, cos_2 = pad / pad_length, window / window_length
    scale = by_pad / (reach * pad_length)
    return LayeredWay(
        mi.Vector3f(across.x * scale, across.y * scale, -cos_1), cos_1, cos_2, pad_length,
        window_length, way_spread(bond, pad, window, cos_1, cos_2),
    )  # fmt: skip


def way_spread(
    bond: WindowBond, pad: mi.Float, window: mi.Float, pad_cos: mi.Float, window_cos: mi.Float
) -> mi.Float:
    """Return the ``spread`` of a `LayeredWay` across heights ``pad`` and ``window`` (mm)."""
    # Lateral ways per angle in the pad, in the plane of incidence and across it.
    aside = pad / pad_cos + window / (window_cos * bond.ratio)
    bent = window * pad_cos / (bond.ratio * window_cos * dr.square(window_cos))
    return aside * pad_cos * (pad / dr.square(pad_cos) + bent)


@dataclass
class Tube:
    """How light from a point spreads behind the face that it leaves by (a Dr.Jit PyTree).

    ``distance`` mm behind it the area across the light per solid angle at the point is
    ``area + distance (first + distance second)``, in mm^2 / sr.
    """

    area: mi.Float
    first: mi.Float
    second: mi.Float

    def at(self, distance: mi.Float) -> mi.Float:
        """Return the area per solid angle."""
        distance = dr.maximum(distance, 0.0)
        return dr.abs(self.area + distance * (self.first + distance * self.second))


def tube_behind(
    bond: WindowBond, d: mi.Vector3f, from_window: mi.Bool, in_window: mi.Bool,
    pad_length: mi.Float, window_length: mi.Float, outward: mi.Vector3f, outside: mi.Vector3f,
) -> Tube:  # fmt: skip
    """Return how light spreads that began in the pad, or ``from_window``, and leaves along ``d``.

    It has gone so far (mm) in either medium and leaves, ``in_window`` or not, by a face with the
    normal ``outward``, behind which it goes ``outside``. Differentials of the ray, in the plane of
    incidence of the bond and across it, are carried to the face and through it (Igehy 1999).
    """
    index = dr.select(in_window, bond.window, bond.pad)
    slow = dr.hypot(d.x, d.y)
    toward_x = dr.select(slow > 1e-6, d.x / slow, 1.0)
    toward_y = dr.select(slow > 1e-6, d.y / slow, 0.0)
    cosine = dr.maximum(dr.abs(d.z), 1e-6)
    cos_1, cos_2 = (
        dr.sqrt(dr.maximum(1.0 - dr.square(slow * index / of), 1e-12))
        for of in (bond.pad, bond.window)
    )
    # Angles in the window, and in the pad, per angle where it began.
    bent = dr.select(from_window, 1.0, cos_1 / (bond.ratio * cos_2))
    turned = dr.select(from_window, 1.0, dr.rcp(bond.ratio))
    pad_bent = dr.select(from_window, cos_2 * bond.ratio / cos_1, 1.0)
    pad_turned = dr.select(from_window, bond.ratio, 1.0)
    moved_in = (pad_length * pad_bent / cos_1 + window_length * bent / cos_2) * cosine
    moved_across = pad_length * pad_turned + window_length * turned
    steeper = mi.Vector3f(toward_x * cosine, toward_y * cosine, -dr.mulsign(slow, d.z))
    aside = mi.Vector3f(-toward_y, toward_x, 0.0)
    differentials = []
    for moved, direction, angle in (
        (moved_in, steeper, dr.select(in_window, bent, pad_bent)),
        (moved_across, aside, dr.select(in_window, turned, pad_turned)),
    ):
        at_face = moved * direction
        at_face -= d * (dr.dot(outward, at_face) / dr.dot(outward, d))
        along_face = index * angle * (direction - outward * dr.dot(outward, direction))
        # The part along the normal makes it a unit vector.
        leaving = -dr.dot(outside, along_face) / dr.dot(outside, outward)
        differentials.append((at_face, along_face + leaving * outward))
    (p, turn_p), (q, turn_q) = differentials

    def area(a: mi.Vector3f, b: mi.Vector3f) -> mi.Float:
        return dr.dot(outside, dr.cross(a, b))

    return Tube(area(p, q), area(p, turn_q) + area(turn_p, q), area(turn_p, turn_q))


@dataclass
class WallReflections:
    """What walls leave of light on a way (``reflected``), and the ``chance`` to follow it."""

    reflected: mi.Float
    chance: mi.Float


def reflected_by_walls(
    bond: WindowBond, box: tuple[mi.Vector3f, mi.Vector3f], metal: mi.Float, a: mi.Vector3f,
    direction: mi.Vector3f, in_window: tuple[mi.Float, mi.Float], counts: list[mi.Float],
) -> WallReflections:  # fmt: skip
    """Return what walls reflect on a way from ``a`` along ``direction``, which is that in the pad.

    Where all of it is in the window, x and y are what they would be in the pad. ``box`` are the
    lowest and highest corner (mm); ``metal`` is what sides reflect, -1 by Fresnel's equations. The
    way is in the window between two distances ``in_window`` along the bond (mm) and meets walls
    ``counts`` times across x and y, at most twice.
    """
    low, high = box
    slow = dr.maximum(dr.hypot(direction.x, direction.y), 1e-6)
    reflected, chance = mi.Float(1.0), mi.Float(1.0)
    for axis in range(2):
        part = direction[axis] / slow
        up, share = part > 0, dr.maximum(dr.abs(part), 1e-6)
        first = dr.select(up, high[axis] - a[axis], a[axis] - low[axis])
        for met in range(2):
            at = (first + met * (high[axis] - low[axis])) / share
            below = (at > in_window[0]) & (at < in_window[1])
            cosine = dr.abs(direction[axis]) * dr.select(below, dr.rcp(bond.ratio), 1.0)
            index = dr.select(below, bond.window, bond.pad)
            upper = up if met == 0 else ~up
            of_metal = dr.gather(mi.Float, metal, 2 * axis + dr.select(upper, mi.UInt32(1), 0))
            by_fresnel = mi.fresnel(cosine, dr.rcp(index))[0]
            there = counts[axis] > met + 0.5
            once = dr.select(of_metal < 0, by_fresnel, of_metal)
            reflected *= dr.select(there, once, 1.0)
            chance *= dr.select(there, dr.select(of_metal < 0, by_fresnel, 1.0), 1.0)
    return WallReflections(reflected, chance)
