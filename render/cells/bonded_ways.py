"""Ways of light from lamps into a flat pad of smooth faces over a window of another index.

As in ``render.cells.lamp_ways``, but for the bond, where light is bent on its way down and up. By
Fermat's principle its line is the shortest (``render.cells.bonded_aim``). What a bond reflects is
left to camera subpaths, so along z there are four ways, in the place of cells: straight, or over
the lower face; to a face of the pad, or of the window.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from render.cells.bond_optics import Bond, Tube, reflected_by_walls, tube_behind
from render.cells.bonded_aim import shortest_way
from render.cells.fiber_light import COSINE_MIN, FiberLight
from render.cells.lamp_ways import (
    BEHIND,
    CODES,
    Joined,
    LampLine,
    LampWays,
    Way,
    code_of,
    side_of,
    travels_up,
    wall_reflections,
    way_crossing,
)
from render.cells.pad_surfaces import BOND_PASSED, LOWER_MET
from render.geometry import LOWER
from render.scene import Scene

IN_PAD, OVER_LOWER, IN_WINDOW, WINDOW_OVER_LOWER = range(4)
"""Ways along z: they end at a face of the pad, the latter two at one of the window."""
LOWER_SIDE = side_of(LOWER)


@dataclass
class BondedLine(LampLine):
    """A line that a bond may have bent (a Dr.Jit PyTree): ``tube`` says how its light spreads."""

    tube: Tube

    def spread(self, index: float) -> Callable[[mi.Float], mi.Float]:
        """Return what becomes of a solid angle in the pad, so many mm behind its face."""
        return self.tube.at


class BondedWays(LampWays):
    """All ways of all lamps of such a pad."""

    def __init__(self, scene: Scene, light: FiberLight, bond: Bond) -> None:
        """List the ways and weigh them on a grid of points of the coating."""
        self.bond = bond
        super().__init__(scene, light)

    @property
    def depths(self) -> tuple[int, ...]:
        """The ways along z, as z of cells."""
        return (-IN_PAD, -OVER_LOWER, -IN_WINDOW, -WINDOW_OVER_LOWER)

    def _possible(self, way: Way) -> bool:
        """Return whether the faces on the way reflect, and it leaves where it ends."""
        x, y, depth = way.cells[0], way.cells[1], -way.cells[2]
        if way.face == LOWER:
            if depth != IN_WINDOW:
                return False
        else:
            cell = way.cells[side_of(way.face) // 2]
            if cell and travels_up(way) != (cell > 0):
                return False
        reflects = np.ones(6, dtype=bool)
        for face, there in enumerate(self._mirror):
            reflects[side_of(face)] = there
        counts = wall_reflections((x, y, 0))
        counts[LOWER_SIDE] = int(depth in (OVER_LOWER, WINDOW_OVER_LOWER))
        return bool(reflects[np.nonzero(counts)[0]].all())

    def _numbers(self, way: Way) -> tuple[list[float], NDArray[np.int64]]:
        """Return the 16 numbers of a way's line, and how often each side reflects."""
        depth = -way.cells[2]
        row, counts = super()._numbers(Way(way.face, (way.cells[0], way.cells[1], 0)))
        low, high = float(self.low[2]), float(self.high[2])
        over_lower = depth in (OVER_LOWER, WINDOW_OVER_LOWER)
        counts[LOWER_SIDE] = int(over_lower)
        row[2], row[5] = (-1.0, 2.0 * low) if over_lower else (1.0, 0.0)
        # Where along z of the unfolded pad the way may end.
        begin, end = {
            IN_PAD: (0.0, high), OVER_LOWER: (2.0 * low - high, 2.0 * low),
            IN_WINDOW: (low, 0.0), WINDOW_OVER_LOWER: (2.0 * low, low),
        }[depth]  # fmt: skip
        row[8], row[11], row[15] = begin, end - begin, float(depth)
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
        straight, over, window = depth < 0.5, dr.abs(depth - 1.0) < 0.5, depth > 1.5
        point = self.light.sample_position(lamp, pick, square)[0]
        image = sign * mi.Vector3f(point) + shift
        normal = mi.Vector3f(*(dr.select(axis == float(i), travel, 0.0) for i in range(3)))
        inside = travel * (plane - dr.dot(begins, dr.abs(normal)))
        outside = dr.dot(image - begins, normal) - inside
        valid = known & (inside > 0) & (outside > -BEHIND)
        image += normal * dr.maximum(1e-4 - outside, 0.0)
        # --------------------------- The line ------------------------------------------------
        layer = dr.select(window, a.z, dr.select(over, 2.0 * bond.thickness, 0.0))
        index = dr.select(window, bond.plate, bond.pad)
        found = shortest_way(
            begins, layer, dr.select(over, bond.plate, bond.pad), mi.Bool(False),
            plane * dr.abs(normal), -normal, image, index,
        )  # fmt: skip
        # In one medium there is a formula.
        by_face = way_crossing(begins, image, normal, inside, self.index)
        first, second = found.bond - begins, found.face - found.bond
        first_length, second_length = dr.norm(first), dr.maximum(dr.norm(second), 1e-6)
        leaves = dr.select(straight, by_face, found.face)
        alone = by_face - begins
        alone_length = dr.norm(alone)
        onward = dr.select(straight, alone / alone_length, second / second_length)
        direction = dr.select(window, first / dr.maximum(first_length, 1e-6), onward)
        pad_length = dr.select(straight, alone_length, second_length)
        pad_length = dr.select(window, first_length, pad_length)
        below = dr.select(straight, 0.0, first_length)
        below = dr.select(window, second_length, below)
        offset = leaves - begin
        for i in range(3):
            within = (offset[i] >= 0) & (offset[i] <= size[i])
            valid &= within | (axis == float(i))
        inside_cos = dr.dot(onward, normal)
        along = index * (onward - inside_cos * normal)
        outside_cos = dr.sqrt(dr.maximum(1.0 - dr.squared_norm(along), 0.0))
        valid &= (outside_cos > COSINE_MIN) & (inside_cos > 0)
        beyond = along + outside_cos * normal
        # --------------------------- What the faces let through ------------------------------
        through = 1.0 - mi.fresnel(dr.abs(inside_cos), dr.rcp(index))[0]
        aside = dr.hypot(direction.x, direction.y)
        pad_cos = dr.maximum(dr.abs(direction.z), 1e-6)
        down = a.z * aside / pad_cos
        up = down + dr.hypot(first.x, first.y)
        walls = reflected_by_walls(
            bond, self.box, self.metal_sides, begins, direction,
            (dr.select(straight, dr.inf, down), dr.select(over, up, dr.inf)),
            [
                dr.gather(mi.Float, self.counts, 6 * at + 2 * i)
                + dr.gather(mi.Float, self.counts, 6 * at + 2 * i + 1)
                for i in range(2)
            ],
        )  # fmt: skip
        passed = bond.passed(pad_cos)
        through *= dr.select(straight, 1.0, dr.select(over, dr.square(passed), passed))
        plate_cos = dr.sqrt(dr.maximum(1.0 - dr.square(aside / bond.ratio), 0.0))
        by_lower = mi.fresnel(plate_cos, dr.rcp(bond.plate))[0]
        metal = dr.gather(mi.Float, self.metal_sides, mi.UInt32(LOWER_SIDE))
        lower = dr.gather(mi.Float, self.counts, 6 * at + LOWER_SIDE) > 0.5
        once = dr.select(metal < 0, by_lower, metal)
        chance = through * walls.chance
        chance *= dr.select(lower, dr.select(metal < 0, by_lower, 1.0), 1.0)
        through *= walls.reflected * dr.select(lower, once, 1.0)
        tube = tube_behind(bond, onward, window, pad_length, below, normal, beyond)
        line = BondedLine(
            mi.Point3f(sign * (leaves - shift)), sign * beyond, pad_length + below, inside_cos,
            outside_cos, tube,
        )  # fmt: skip
        return Joined(direction, line, through, chance, valid)

    def leaving(
        self, p: mi.Point3f, n: mi.Normal3f, d: mi.Vector3f, outside: mi.Vector3f,
        before: mi.Float, below: mi.Float, inside_cos: mi.Float, outside_cos: mi.Float,
    ) -> LampLine:  # fmt: skip
        """Return the line of light that leaves a face, as of `LampWays`."""
        tube = tube_behind(self.bond, d, p.z < 0.0, before, below, mi.Vector3f(n), outside)
        return BondedLine(p, outside, before + below, inside_cos, outside_cos, tube)

    def code(self, counts: mi.Vector3u, up: mi.Vector3u, n: mi.Normal3f) -> mi.UInt32:
        """Return the number of the way of a chain of reflections, CODES where it has none.

        Along z ``counts`` are as ``render.cells.pad_surfaces`` counts.
        """
        depth = mi.UInt32(CODES)
        for way, count in (
            (IN_PAD, 0), (OVER_LOWER, 2 * BOND_PASSED + LOWER_MET), (IN_WINDOW, BOND_PASSED),
            (WINDOW_OVER_LOWER, BOND_PASSED + LOWER_MET),
        ):  # fmt: skip
            depth = dr.select(counts.z == count, way, depth)
        known = depth < CODES
        return dr.select(known, code_of(counts, up, n, dr.select(known, depth, 0)), CODES)
