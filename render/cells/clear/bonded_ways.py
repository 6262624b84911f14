"""Ways of light from lamps into a flat pad of smooth faces over a window of another index.

As in ``render.cells.clear.lamp_ways``, but for the bond, where light is bent on its way down and
up. By Fermat's principle its line is the shortest (``render.cells.crossings``). In the place
of cells along z there are `LEVELS`: ways to a face of the pad, and others to one of the window,
over lower face and bond, from points of the skin and from white paint around the window. Longer
ones are left to camera subpaths.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from render.arrays import Array
from render.cells.clear.bond_optics import Tube, WindowBond, reflected_by_walls, tube_behind
from render.cells.clear.lamp_ways import BEHIND, GRID, Joined, LampLine, LampWays, face_way
from render.cells.clear.pad_surfaces import BOND_MET, BOND_PASSED, FROM_WINDOW, LOWER_MET, NO_TURN
from render.cells.clear.unfolded_cells import (
    CODES,
    LampWay,
    box_image,
    code_of,
    side_of,
    travels_up,
    wall_reflections,
)
from render.cells.crossings import shortest_way
from render.cells.fiber_light import COSINE_MIN, FiberLight
from render.geometry import LOWER
from render.scene import OUTWARD, Scene


@dataclass(frozen=True)
class _Level:
    """How a way goes along z.

    Light passes the bond ``passed`` times, and is reflected ``by_lower`` face and ``by_bond`` so
    often; ``in_window`` says that it ends at a face of the window, ``from_window`` that it begins
    at one. It ``rises`` where it begins, or not, where that makes two ways of one.
    """

    passed: int
    by_lower: int
    by_bond: int
    in_window: bool
    from_window: bool = False
    rises: bool | None = None

    @property
    def count(self) -> int:
        """What ``render.cells.clear.pad_surfaces`` counts."""
        met = self.passed * BOND_PASSED + self.by_lower * LOWER_MET + self.by_bond * BOND_MET
        return met + self.from_window * FROM_WINDOW

    @property
    def straight(self) -> bool:
        """Whether it stays in the medium where it begins."""
        return self.passed == 0

    @property
    def goes_up(self) -> bool:
        """Whether a way from the window goes up where it begins, if it may go but one way."""
        return bool(self.rises) or self.by_lower == 0

    @property
    def turn(self) -> int:
        """Where a bond reflects it, as of `PadSurfaces.blocked`: in the window behind the first."""
        return self.passed if self.by_bond else NO_TURN

    @property
    def window_cell(self) -> int:
        """Cell of the unfolded window in which it ends there."""
        folds = self.by_lower + self.by_bond
        return folds if self.from_window and self.goes_up else -folds


LEVELS = (
    _Level(0, 0, 0, False), _Level(2, 1, 0, False), _Level(1, 0, 0, True), _Level(1, 1, 0, True),
    _Level(0, 0, 1, False), _Level(1, 1, 1, True), _Level(1, 2, 1, True),
    # From paint around the window.
    _Level(0, 0, 0, True, True), _Level(0, 1, 0, True, True), _Level(0, 0, 1, True, True),
    _Level(0, 1, 1, True, True, rises=True), _Level(0, 1, 1, True, True, rises=False),
    _Level(1, 0, 0, False, True), _Level(1, 1, 0, False, True),
)  # fmt: skip
"""The ways along z that are known, by their number."""
OVER_LOWER, IN_WINDOW = 1, 2
LOWER_SIDE = side_of(LOWER)
MISSED = 1e-3
"""mm by which the line that Snell's law bends may miss the point on the lamp."""


@dataclass
class BondedLine(LampLine):
    """A line that a bond may have bent (a Dr.Jit PyTree): ``tube`` says how its light spreads."""

    tube: Tube

    def spread(self, _index: float) -> Callable[[mi.Float], mi.Float]:
        """Return what becomes of a solid angle in the pad, so many mm behind its face."""
        return self.tube.at


class BondedWays(LampWays):
    """All ways of all lamps of such a pad."""

    def __init__(self, scene: Scene, light: FiberLight, bond: WindowBond) -> None:
        """List the ways and weigh them on a grid of points of the coating, and of paint below."""
        assert scene.window is not None
        self.bond, self.window_index = bond, scene.window.index
        self._white = [face for face, finish in enumerate(scene.finishes) if finish.white]
        super().__init__(scene, light)

    @property
    def depths(self) -> tuple[int, ...]:
        """The ways along z, as z of cells."""
        return tuple(-n for n, level in enumerate(LEVELS) if self._white or not level.from_window)

    def _from_window(self) -> NDArray[np.bool_]:
        """Return whether ways begin in the window, ``(entry,)``."""
        number = np.array(self.rows).reshape(-1, 16)[:, 15].astype(int)
        return np.array([level.from_window for level in LEVELS])[number]

    def _strength(self) -> Array:
        """Return about how much light comes over each way to where it may begin, ``(entry,)``."""
        strength = super()._strength()
        step = (np.arange(GRID) + 0.5) / GRID
        for face in self._white:
            axis, upper = divmod(side_of(face), 2)
            along = 1 - axis
            points = np.empty((GRID, GRID, 3))
            points[..., axis] = self.high[axis] if upper else self.low[axis]
            points[..., along] = self.low[along] + step * (self.high - self.low)[along]
            points[..., 2] = self.low[2] * step[:, None]
            strength += self._arriving(points.reshape(-1, 3), -np.array(OUTWARD[face], float))
        return strength

    def _possible(self, way: LampWay) -> bool:
        """Return whether the faces on the way reflect, and it leaves where it ends."""
        x, y, depth = way.cells[0], way.cells[1], -way.cells[2]
        if way.face == LOWER:
            level = LEVELS[depth]
            above = level.from_window and level.straight and level.by_lower == 0
            if depth != IN_WINDOW and not above:
                return False
        else:
            cell = way.cells[side_of(way.face) // 2]
            if cell and travels_up(way) != (cell > 0):
                return False
        reflects = np.ones(6, dtype=bool)
        for face, there in enumerate(self._mirror):
            reflects[side_of(face)] = there
        counts = wall_reflections((x, y, 0))
        counts[LOWER_SIDE] = LEVELS[depth].by_lower
        return bool(reflects[np.nonzero(counts)[0]].all())

    def _numbers(self, way: LampWay) -> tuple[list[float], NDArray[np.int64]]:
        """Return the 16 numbers of a way's line, and how often each side reflects."""
        depth = -way.cells[2]
        row, counts = super()._numbers(LampWay(way.face, (way.cells[0], way.cells[1], 0)))
        level, low, high = LEVELS[depth], float(self.low[2]), float(self.high[2])
        counts[LOWER_SIDE] = level.by_lower
        # Planes that mirror, and between which heights the way may end, unfolded.
        if level.in_window:
            cell = level.window_cell
            window = np.array([0.0, 0.0, low]), np.zeros(3)
            sign, shift = box_image(*window, (0, 0, cell))
            row[2], row[5] = float(sign[2]), float(shift[2])
            row[8], row[11] = low - cell * low, -low
            if way.face == LOWER and level.by_bond:
                row[13], row[14] = 1.0, -low
        else:
            plane = level.by_lower * low
            mirrored = level.by_lower + level.by_bond > 0
            row[2], row[5] = (-1.0, 2.0 * plane) if mirrored else (1.0, 0.0)
            row[8], row[11] = (2.0 * plane - high if mirrored else 0.0), high
        row[15] = float(depth)
        return row, counts

    def join(
        self, entry: mi.UInt32, lamp: mi.UInt32, a: mi.Point3f, pick: mi.Float, square: mi.Point2f
    ) -> Joined:
        """Return the line of a way from ``a`` to a point on the lamp's end, as of `LampWays`."""
        bond, begins = self.bond, mi.Vector3f(a)
        known = entry < self.entries
        at = dr.minimum(entry, self.entries - 1)
        row = [dr.gather(mi.Float, self.rows, 16 * at + i) for i in range(16)]
        sign, shift = mi.Vector3f(row[0:3]), mi.Vector3f(row[3:6])
        begin, size = mi.Vector3f(row[6:9]), mi.Vector3f(row[9:12])
        axis, travel, plane, depth = row[12:16]
        number = mi.UInt32(depth)
        straight, window, from_window = (mi.Bool(False) for _ in range(3))
        for n, level in enumerate(LEVELS):
            straight |= (number == n) & level.straight
            window |= (number == n) & level.in_window
            from_window |= (number == n) & level.from_window
        over = number == OVER_LOWER
        by_lower_met = dr.gather(mi.Float, self.counts, 6 * at + LOWER_SIDE)
        rises = from_window & (by_lower_met == 0.0)
        point = self.light.sample_position(lamp, pick, square)[0]
        image = sign * mi.Vector3f(point) + shift
        normal = mi.Vector3f(*(dr.select(axis == float(i), travel, 0.0) for i in range(3)))
        inside = travel * (plane - dr.dot(begins, dr.abs(normal)))
        outside = dr.dot(image - begins, normal) - inside
        valid = known & ((a.z < 0) == from_window) & (inside > 0) & (outside > -BEHIND)
        image += normal * dr.maximum(1e-4 - outside, 0.0)
        # --------------------------- The line ------------------------------------------------
        layer = dr.select(window, a.z, dr.select(over, 2.0 * bond.thickness, 0.0))
        below = dr.select(rises, -a.z, 2.0 * bond.thickness + a.z)
        layer = dr.select(straight, 0.0, dr.select(from_window, below, layer))
        index = dr.select(window, bond.window, bond.pad)
        found = shortest_way(
            begins, layer, dr.select(over | from_window, bond.window, bond.pad), rises,
            plane * dr.abs(normal), -normal, image, index,
        )  # fmt: skip
        # In one medium there is a formula.
        depth_there = dr.maximum(inside, 1e-4)
        lateral, across = face_way(image - begins, normal, depth_there, outside, self.index)
        if self._white:
            by_window, _ = face_way(image - begins, normal, depth_there, outside, self.window_index)
            lateral = dr.select(window, by_window, lateral)
        alone = lateral * across + depth_there * normal
        first, second = found.bond - begins, found.face - found.bond
        first_length, second_length = dr.norm(first), dr.maximum(dr.norm(second), 1e-6)
        leaves = dr.select(straight, begins + alone, found.face)
        alone_length = dr.norm(alone)
        onward = dr.select(straight, alone / alone_length, second / second_length)
        by_first = ~straight & (window | from_window)
        direction = dr.select(by_first, first / dr.maximum(first_length, 1e-6), onward)
        pad_length = dr.select(straight, alone_length, second_length)
        pad_length = dr.select(window, dr.select(straight, 0.0, first_length), pad_length)
        below = dr.select(straight, 0.0, first_length)
        below = dr.select(window, dr.select(straight, alone_length, second_length), below)
        offset = leaves - begin
        for i in range(3):
            within = (offset[i] >= 0) & (offset[i] <= size[i])
            valid &= within | (axis == float(i))
        inside_cos = dr.dot(onward, normal)
        along = index * (onward - inside_cos * normal)
        outside_cos = dr.sqrt(dr.maximum(1.0 - dr.squared_norm(along), 0.0))
        valid &= (outside_cos > COSINE_MIN) & (inside_cos > 0)
        beyond = along + outside_cos * normal
        # The shortest line need not be one that light takes: it may run along the bond.
        scale = dr.select(window, dr.rcp(bond.ratio), bond.ratio)
        kink = scale * first / dr.maximum(first_length, 1e-6) - second / second_length
        missed = dr.hypot(kink.x, kink.y) * dr.maximum(second_length, 1.0)
        missed += dr.norm(dr.norm(image - leaves) * beyond - (image - leaves))
        valid &= straight | (missed < MISSED)
        # --------------------------- What the faces let through ------------------------------
        through = 1.0 - mi.fresnel(dr.abs(inside_cos), dr.rcp(index))[0]
        aside = dr.hypot(direction.x, direction.y)
        steep = dr.abs(direction.z)
        in_pad = dr.sqrt(dr.maximum(1.0 - dr.square(bond.ratio * aside), 0.0))
        pad_cos = dr.maximum(dr.select(from_window, in_pad, steep), 1e-6)
        window_cos = dr.select(from_window, steep, bond.window_cos(pad_cos))
        down = dr.select(from_window, -1.0, a.z * aside / pad_cos)
        up = dr.maximum(down, 0.0) + dr.hypot(first.x, first.y)
        passes = over | (from_window & ~straight)
        walls = reflected_by_walls(
            bond, self.box, self.metal_sides, begins,
            direction * dr.select(from_window, bond.ratio, 1.0),
            (
                dr.select(straight & ~from_window, dr.inf, down),
                dr.select(passes, up, dr.inf),
            ),
            [
                dr.gather(mi.Float, self.counts, 6 * at + 2 * i)
                + dr.gather(mi.Float, self.counts, 6 * at + 2 * i + 1)
                for i in range(2)
            ],
        )  # fmt: skip
        passed = bond.passed(pad_cos)
        at_bond, turn = mi.Float(1.0), mi.UInt32(NO_TURN)
        for i in range(1, len(LEVELS)):
            level = LEVELS[i]
            both = passed**level.passed * (1.0 - passed) ** level.by_bond
            at_bond = dr.select(number == i, both, at_bond)
            turn = dr.select(number == i, level.turn, turn)
        through *= at_bond
        by_lower = mi.fresnel(window_cos, dr.rcp(bond.window))[0]
        metal = dr.gather(mi.Float, self.metal_sides, mi.UInt32(LOWER_SIDE))
        once, followed = dr.select(metal < 0, by_lower, metal), dr.select(metal < 0, by_lower, 1.0)
        chance = through * walls.chance
        through *= walls.reflected
        for met in (0.5, 1.5):
            through *= dr.select(by_lower_met > met, once, 1.0)
            chance *= dr.select(by_lower_met > met, followed, 1.0)
        tube = tube_behind(bond, onward, from_window, window, pad_length, below, normal, beyond)
        line = BondedLine(
            mi.Point3f(sign * (leaves - shift)), sign * beyond, pad_length + below, inside_cos,
            outside_cos, tube,
        )  # fmt: skip
        return Joined(direction, line, through, chance, turn, valid)

    def leaving(
        self, begin: mi.Point3f, p: mi.Point3f, n: mi.Normal3f, d: mi.Vector3f,
        outside: mi.Vector3f, before: mi.Float, below: mi.Float, inside_cos: mi.Float,
        outside_cos: mi.Float,
    ) -> LampLine:  # fmt: skip
        """Return the line of light that leaves a face, as of `LampWays`."""
        tube = tube_behind(
            self.bond, d, begin.z < 0.0, p.z < 0.0, before, below, mi.Vector3f(n), outside
        )
        return BondedLine(p, outside, before + below, inside_cos, outside_cos, tube)

    def code(self, counts: mi.Vector3u, up: mi.Vector3u, n: mi.Normal3f) -> mi.UInt32:
        """Return the number of the way of a chain of reflections, CODES where it has none.

        Along z ``counts`` are as ``render.cells.clear.pad_surfaces`` counts.
        """
        depth = mi.UInt32(CODES)
        for number, level in enumerate(LEVELS):
            this = counts.z == level.count
            if level.rises is not None:
                this &= (up.z > 0) == level.rises
            depth = dr.select(this, number, depth)
        known = depth < CODES
        return dr.select(known, code_of(counts, up, n, dr.select(known, depth, 0)), CODES)
