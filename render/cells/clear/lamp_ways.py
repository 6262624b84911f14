"""Ways of light from lamps into a flat pad of smooth faces, each found without chance.

A flat pad is a box of silicone. Unfolded over its walls (image method) every way from a lamp to a
point inside is one straight line that is bent once, by Snell's law, in the face where it enters. So
points of the coating are joined to a point on the lamp's end in the manner of next event estimation
(manifold next event estimation, Hanika et al. 2015, has one solution here): the line is found by
Newton's method, and its density per solid angle is that of the point on the lamp's end times what
the refraction spreads.

A *way* is a face and a cell of the unfolded pad (``render.cells.clear.unfolded_cells``). Over a
window of another index lines are bent at its bond too (``render.cells.clear.bonded_ways``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from render.arrays import Array
from render.cells.clear.pad_surfaces import NO_TURN
from render.cells.clear.unfolded_cells import (
    CELL_MAX,
    CODES,
    DOWN,
    LampWay,
    box_image,
    code_of,
    side_of,
    travels_up,
    wall_reflections,
)
from render.cells.clear.way_draws import WayDraws
from render.cells.crossings import face_crossing
from render.cells.fiber_light import COSINE_MIN, FiberLight, LampRay
from render.geometry import fiber_poses
from render.scene import Scene

PROFILE_FLOOR = 0.05
"""Least radiance, over that of the axis, in the shares of ways: beams may be narrow."""
NEWTON_STEPS = 5
EDGE = 1.0002
"""How wide a lamp's end is for the lines that they find."""
GRID = 16
"""Points of the coating along x and y at which shares of ways are estimated."""
BEHIND = 1e-3
"""mm by which a lamp may seem to lie behind the face that it touches."""


@dataclass
class LampLine:
    """A line from a point in the pad that leaves it at ``exit`` along ``outside``.

    A Dr.Jit PyTree. ``before`` is its length (mm) in the silicone; ``inside`` and ``outside_cos``
    are the cosines of refraction on both sides of the face.
    """

    exit: mi.Point3f
    outside: mi.Vector3f
    before: mi.Float
    inside_cos: mi.Float
    outside_cos: mi.Float

    def spread(self, index: float) -> Callable[[mi.Float], mi.Float]:
        """Return what becomes of a solid angle in the pad, so many mm behind its face."""
        cos_out = dr.maximum(self.outside_cos, COSINE_MIN)
        ratio_in, ratio_out = cos_out / self.inside_cos, self.inside_cos / cos_out

        def area(distance: mi.Float) -> mi.Float:
            """Return what refraction makes of it, in and across the plane of incidence."""
            after = index * dr.maximum(distance, 0.0)
            return (self.before * ratio_in + after * ratio_out) * (self.before + after)

        return area


@dataclass
class Joined:
    """A point of the pad joined to a lamp (a Dr.Jit PyTree).

    ``direction`` there, and the ``line`` with its end folded back into the pad; ``through`` is the
    part of the light that all faces let through or reflect and ``chance`` the probability with
    which a path that follows the line gets through; ``turn`` is where a bond reflects it
    (`PadSurfaces.blocked`).
    """

    direction: mi.Vector3f
    line: LampLine
    through: mi.Float
    chance: mi.Float
    turn: mi.UInt32
    valid: mi.Bool


class LampWays:
    """All ways of all lamps of a flat pad, and with what probability each is taken."""

    def __init__(self, scene: Scene, light: FiberLight) -> None:
        """List the ways and weigh them on a grid of points of the coating."""
        self.light, self.index = light, scene.pad.index
        self.lamps = scene.lamp_count
        self.low, self.high = scene.box.low, scene.box.high
        # Beside the skin, over a clear rim.
        self._strip = bool(scene.box.layered.any())
        metal = np.array([-1.0 if f.metal is None else f.metal for f in scene.finishes])
        self._mirror = np.array([f.smooth or f.metal is not None for f in scene.finishes])
        self._smooth = np.array([f.smooth for f in scene.finishes])
        # What faces reflect, by axis and side; -1 where Fresnel's equations say that.
        by_side = np.full(6, -1.0, dtype=np.float32)
        for face, value in enumerate(metal):
            by_side[side_of(face)] = value
        self.metal_sides = mi.Float(by_side)
        self.metal = self.metal_sides if (metal >= 0).any() else None
        self.box = mi.Vector3f(*self.low.tolist()), mi.Vector3f(*self.high.tolist())
        dr.make_opaque(self.metal_sides, self.box)
        candidates = self._candidates(scene)
        self._upload([(lamp, way) for lamp, ways in enumerate(candidates) for way in ways])
        self._weigh(candidates)

    # -- which ways there are ------------------------------------------------------------------

    def _candidates(self, scene: Scene) -> list[list[LampWay]]:
        """Return the ways that each lamp could send light over."""
        poses = fiber_poses(scene, 0.0)
        found: list[list[LampWay]] = []
        for lamp in range(self.lamps):
            # A lamp that turns sweeps a ball; one that does not is taken for one here.
            outside = np.array(
                [_outside(self.low, self.high, face, poses.position[lamp]) for face in range(5)]
            )
            exits = np.nonzero(self._smooth & (outside > -poses.radius[lamp]))[0]
            ways = [
                LampWay(int(face), (x, y, z))
                for face in exits
                for x in range(-CELL_MAX, CELL_MAX + 1)
                for y in range(-CELL_MAX, CELL_MAX + 1)
                for z in self.depths
            ]
            found.append([way for way in ways if self._possible(way)])
        return found

    @property
    def depths(self) -> tuple[int, ...]:
        """The z of cells."""
        return (0, -1, -2, -3, -4) if self._strip else (0, -1)

    def _possible(self, way: LampWay) -> bool:
        """Return whether the faces on the way reflect, and it leaves the pad where it ends."""
        cell = way.cells[side_of(way.face) // 2]
        if cell and travels_up(way) != (cell > 0):
            return False
        reflects = np.zeros(6, dtype=bool)
        reflects[5] = self._strip
        for face, there in enumerate(self._mirror):
            reflects[side_of(face)] = there
        counts = wall_reflections(way.cells)
        return bool(reflects[np.nonzero(counts)[0]].all())

    def _upload(self, entries: list[tuple[int, LampWay]]) -> None:
        """Upload what the lines of ``entries`` need."""
        rows = np.zeros((len(entries), 16), dtype=np.float32)
        counts = np.zeros((len(entries), 6), dtype=np.float32)
        codes = np.zeros(len(entries), dtype=np.uint32)
        for row, (_, way) in enumerate(entries):
            rows[row], counts[row] = self._numbers(way)
            codes[row] = way.code
        self.entries = len(entries)
        self.rows, self.counts = mi.Float(rows.ravel()), mi.Float(counts.ravel())
        self.lamp_of = mi.UInt32(np.array([lamp for lamp, _ in entries], dtype=np.uint32))
        self.code_of = mi.UInt32(codes)
        dr.make_opaque(self.rows, self.counts, self.lamp_of, self.code_of)

    def _numbers(self, way: LampWay) -> tuple[list[float], NDArray[np.int64]]:
        """Return the 16 numbers of a way's line, and how often each side reflects."""
        low, size = self.low, self.high - self.low
        axis = side_of(way.face) // 2
        travel = 1.0 if travels_up(way) else -1.0
        sign, shift = box_image(low, self.high, way.cells)
        begin = low + np.array(way.cells) * size
        plane = begin[axis] + (size[axis] if travel > 0 else 0.0)
        return (
            [*sign, *shift, *begin, *size, axis, travel, plane, 0.0], wall_reflections(way.cells)
        )  # fmt: skip

    def _weigh(self, candidates: list[list[LampWay]]) -> None:
        """Decide which ways are evaluated always, and the probabilities of the others."""
        entries = np.arange(self.entries)
        ends = np.cumsum([len(ways) for ways in candidates])
        self.draws = WayDraws(np.split(entries, ends[:-1]), self._strength(), self._from_window())
        table = np.full((self.lamps, CODES + 1), self.entries, dtype=np.uint32)
        lamps, codes = np.array(self.lamp_of), np.array(self.code_of)
        table[lamps, codes] = entries
        self.entry_of = mi.UInt32(table.ravel())
        dr.make_opaque(self.entry_of)

    def _from_window(self) -> NDArray[np.bool_]:
        """Return whether ways begin in a window of another index, ``(entry,)``."""
        return np.zeros(self.entries, dtype=bool)

    def _strength(self) -> Array:
        """Return about how much light comes over each way, ``(entry,)``."""
        size = self.high - self.low
        step = (np.arange(GRID) + 0.5) / GRID
        x, y = np.meshgrid(self.low[0] + size[0] * step, self.low[1] + size[1] * step)
        points = np.column_stack([x.ravel(), y.ravel(), np.full(GRID**2, self.high[2])])
        return self._arriving(points, np.array([0.0, 0.0, -1.0]))

    def _arriving(self, points: Array, n: Array) -> Array:
        """Return the light that comes over each way to ``(point, axis)`` of a face, in the mean."""
        lane = dr.arange(mi.UInt32, self.entries * len(points))
        entry, at = lane // len(points), lane % len(points)
        p = mi.Point3f(*(dr.gather(mi.Float, mi.Float(points[:, i]), at) for i in range(3)))
        lamp = dr.gather(mi.UInt32, self.lamp_of, entry)
        # Each with a point of the lamp's end of its own (R3 sequence).
        pick, u, v = (wrapped(mi.Float(at) * step) for step in (0.8191725, 0.6710436, 0.5497005))
        found = self.join(entry, lamp, p, pick, mi.Point2f(u, v))
        carried = self.along(lamp, found.line)
        peak = self.light.profiles.radiance(lamp, mi.Float(0.0))
        mean = mi.Float(0.0)
        for value in carried.radiance:
            mean += value / len(carried.radiance)
        level = dr.maximum(mean, PROFILE_FLOOR * peak) * found.through
        sent = level * dr.maximum(dr.dot(mi.Normal3f(*n.tolist()), found.direction), 0.05)
        sent = dr.select(found.valid & (carried.joined > 0), sent / carried.joined, 0.0)
        values = np.array(sent, dtype=np.float64).reshape(self.entries, len(points))
        return np.asarray(values.mean(axis=1))

    def entry(self, lamp: mi.UInt32, code: mi.UInt32) -> mi.UInt32:
        """Return the entry of a lamp's way, ``entries`` where there is none."""
        return dr.gather(mi.UInt32, self.entry_of, lamp * (CODES + 1) + dr.minimum(code, CODES))

    # -- lines ----------------------------------------------------------------------------------

    def join(
        self, entry: mi.UInt32, lamp: mi.UInt32, a: mi.Point3f, pick: mi.Float, square: mi.Point2f
    ) -> Joined:
        """Return the line of a way from ``a`` to a point on the lamp's end.

        ``pick`` and ``square`` draw the point as in ``FiberLight.sample_position``.
        """
        known = entry < self.entries
        base = 16 * dr.minimum(entry, self.entries - 1)
        row = [dr.gather(mi.Float, self.rows, base + i) for i in range(15)]
        sign, shift = mi.Vector3f(row[0:3]), mi.Vector3f(row[3:6])
        begin, size = mi.Vector3f(row[6:9]), mi.Vector3f(row[9:12])
        axis, travel, plane = row[12:15]
        point = self.light.sample_position(lamp, pick, square)[0]
        image = sign * mi.Vector3f(point) + shift
        normal = mi.Vector3f(
            *(dr.select(axis == float(i), travel, 0.0) for i in range(3))
        )  # the way that the line goes
        span = image - mi.Vector3f(a)
        height = dr.dot(span, normal)
        inside = travel * (plane - dr.dot(mi.Vector3f(a), dr.abs(normal)))
        outside = height - inside
        valid = known & (inside > 0) & (outside > -BEHIND)
        inside = dr.maximum(inside, 1e-4)
        lateral, across = face_way(span, normal, inside, outside, self.index)
        before = dr.hypot(lateral, inside)
        direction = (lateral * across + inside * normal) / before
        leaves = mi.Vector3f(a) + before * direction
        offset = leaves - begin
        for i in range(3):
            within = (offset[i] >= 0) & (offset[i] <= size[i])
            valid &= within | (axis == float(i))
        inside_cos = inside / before
        sine = self.index * lateral / before
        outside_cos = dr.sqrt(dr.maximum(1.0 - dr.square(sine), 0.0))
        valid &= outside_cos > COSINE_MIN
        beyond = sine * across + outside_cos * normal
        # ------------------------- What the faces let through ---------------------------
        through = 1.0 - mi.fresnel(inside_cos, 1.0 / self.index)[0]
        chance = mi.Float(through)
        for i in range(3):
            reflected = mi.fresnel(dr.abs(direction[i]), 1.0 / self.index)[0]
            for side in range(2):
                count = dr.gather(
                    mi.Float, self.counts, 6 * dr.minimum(entry, self.entries - 1) + 2 * i + side
                )
                once, met = reflected, reflected
                if self.metal is not None:
                    metal = dr.gather(mi.Float, self.metal, mi.UInt32(2 * i + side))
                    once = dr.select(metal < 0, reflected, metal)
                    met = dr.select(metal < 0, reflected, 1.0)
                twice = count > 1.5
                some = count > 0.5
                through *= dr.select(some, dr.select(twice, once * once, once), 1.0)
                chance *= dr.select(some, dr.select(twice, met * met, met), 1.0)
        # ------------------------- Back into the pad itself ------------------------------
        folded = sign * (leaves - shift)
        line = LampLine(mi.Point3f(folded), sign * beyond, before, inside_cos, outside_cos)
        return Joined(direction, line, through, chance, mi.UInt32(NO_TURN), valid)

    def leaving(
        self, _begin: mi.Point3f, p: mi.Point3f, _n: mi.Normal3f, _d: mi.Vector3f,
        outside: mi.Vector3f, before: mi.Float, _below: mi.Float, inside_cos: mi.Float,
        outside_cos: mi.Float,
    ) -> LampLine:  # fmt: skip
        """Return the line of light from ``begin`` that leaves a face at ``p`` along ``outside``.

        ``n`` is the normal and ``d`` the direction before it; the line has gone ``before`` mm
        through the pad, and ``below`` it.
        """
        return LampLine(p, outside, before, inside_cos, outside_cos)

    def along(self, lamp: mi.UInt32, line: LampLine) -> LampRay:
        """Return what ``line`` carries; all of it is 0 where it misses the lamp.

        The density of joining to it is per solid angle at the point in the pad where it began.
        """
        spread = line.spread(self.index)
        return self.light.ray(lamp, line.exit, -line.outside, spread, EDGE, BEHIND)

    def code(self, counts: mi.Vector3u, up: mi.Vector3u, n: mi.Normal3f) -> mi.UInt32:
        """Return the number of the way of a chain of reflections, CODES where it has none.

        Along each axis it was reflected ``counts`` times, having begun ``up`` it or down; it ends
        at a face with the outward normal ``n``.
        """
        # Over a clear rim the far side lets light out as well.
        known = (counts.z < DOWN) & (n.z < 0.5) & ((counts.z == 0) | (up.z == 0))
        return dr.select(known, code_of(counts, up, n, counts.z), CODES)


def _outside(low: Array, high: Array, face: int, p: Array) -> float:
    """Return how far (mm) ``p`` is outside of a face."""
    axis, upper = divmod(side_of(face), 2)
    return float(p[axis] - high[axis] if upper else low[axis] - p[axis])


def wrapped(number: mi.Float) -> mi.Float:
    """Return the fractional part of a number."""
    return number - dr.floor(number)


def face_way(
    span: mi.Vector3f, normal: mi.Vector3f, inside: mi.Float, outside: mi.Float, index: float
) -> tuple[mi.Float, mi.Vector3f]:
    """Return how far, and which way along a face, a line of Snell's law goes until it crosses it.

    It goes by ``span`` in all, the way of ``normal``: ``inside`` and ``outside`` mm.
    """
    across = span - dr.dot(span, normal) * normal
    reach = dr.norm(across)
    across = across / dr.maximum(reach, 1e-9)
    # Not beyond where total reflection begins.
    critical = inside * float(1.0 / np.sqrt(max(index**2 - 1.0, 1e-6)))
    outside = dr.maximum(outside, 1e-4)
    return face_crossing(reach, inside, outside, index, critical, NEWTON_STEPS), across
