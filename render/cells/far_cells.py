"""Cells of the unfolded pad so far away that no table lists them, drawn by a formula.

Where the index is above the root of two, light at some angle to all four walls is reflected totally
by each, so lamps in the pad have images without end. Those at a distance d send what 1 / d^2 says
and there are as many as d between d and d + 1: together they have a tail like the logarithm's,
until something on the coating is in the way. *Ring* r is the cells of which the larger of |x| and
|y| is r. It is drawn with the probability ``first / (r (r + 1))``, and of its cells one in the
angles of total reflection: the others send nothing over so many walls.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from render.scene import FACES, Scene

RING_MAX = 2000
"""What lies beyond is left to camera subpaths that meet the lamp."""
WIDER = 1
"""Cells by which a ring's part goes beyond the angles of total reflection: lamps are extended."""


class FarCells:
    """The cells of rings from ``first`` on, of a flat pad with four mirrors around it."""

    def __init__(self, scene: Scene, first: int, levels: dict[int, float]) -> None:
        """Take the angles of total reflection from the scene, and what of cells have which z."""
        self.first, self.levels = first, levels
        size = (scene.box.high - scene.box.low)[:2]
        most = _steepest(scene)
        # Cells in y over cells in x, at least and at most.
        slope = float(size[0] / size[1])
        rise = np.sqrt(np.maximum(1.0 - most**2, 0.0))
        self.low = slope * float(rise[0] / most[0])
        self.high = slope * float(most[1] / rise[1]) if rise[1] else 1e6

    def _sides(self, ring: mi.Float) -> list[tuple[mi.Float, mi.Float]]:
        """Return the first of the cells along a side in x and one in y, and how many there are."""
        sides = []
        for low, high, end in (
            (self.low, self.high, ring),
            (1.0 / self.high, 1.0 / self.low if self.low else 1e6, ring - 1.0),
        ):
            begin = dr.maximum(dr.ceil(low * ring) - WIDER, 0.0)
            last = dr.minimum(dr.floor(high * ring) + WIDER, end)
            sides.append((begin, dr.maximum(last - begin + 1.0, 0.0)))
        return sides

    def drawn(
        self, far: mi.Float, place: mi.Float, sign: mi.Float
    ) -> tuple[mi.Int32, mi.Int32, mi.Int32, mi.Bool]:
        """Return x, y and z of a cell for three uniform numbers, and whether it is in a ring."""
        ring = dr.floor(float(self.first) / dr.maximum(1.0 - far, 1e-6))
        (begin, count), (other_begin, other_count) = self._sides(ring)
        total = count + other_count
        at = dr.minimum(dr.floor(place * total), total - 1.0)
        along = at < count
        aside = dr.select(along, begin + at, other_begin + at - count)
        quadrant = mi.UInt32(dr.minimum(sign * 4.0, 3.0))
        x, y = dr.select(along, ring, aside), dr.select(along, aside, ring)
        x = dr.select((quadrant & 1) > 0, -x, x)
        y = dr.select((quadrant & 2) > 0, -y, y)
        left, z, below = sign * 4.0 - mi.Float(quadrant), mi.Int32(0), 0.0
        for level, share in self.levels.items():
            z = dr.select(left >= below, level, z)
            below += share
        return mi.Int32(x), mi.Int32(y), z, (ring <= RING_MAX) & (total > 0)

    def probability(self, x: mi.Float, y: mi.Float, z: mi.Int32) -> mi.Float:
        """Return the probability with which a cell is drawn; 0 for those that are not."""
        x, y = dr.abs(x), dr.abs(y)
        ring = dr.maximum(x, y)
        (begin, count), (other_begin, other_count) = self._sides(ring)
        along = x == ring
        aside = dr.select(along, y, x)
        begin, here = dr.select(along, begin, other_begin), dr.select(along, count, other_count)
        inside = (ring >= self.first) & (ring <= RING_MAX)
        inside &= (aside >= begin) & (aside < begin + here)
        # With a coordinate of 0 both signs are one cell.
        share = dr.select(aside == 0, 2.0, 1.0) / 4.0
        level = mi.Float(0.0)
        for known, part in self.levels.items():
            level = dr.select(z == known, part, level)
        share *= level
        share *= self.first / (ring * (ring + 1.0)) / dr.maximum(count + other_count, 1.0)
        return dr.select(inside, share, 0.0)


def has_far_cells(scene: Scene) -> bool:
    """Return whether light at some angle loses as little at four walls as walls can."""
    return bool((_steepest(scene) ** 2).sum() > 1.0)


def _steepest(scene: Scene) -> np.ndarray:
    """Return the largest cosine to the walls across x and across y at which both lose nothing.

    Walls of metal lose the same at all angles; so they have 1.
    """
    total = np.sqrt(max(1.0 - scene.pad.index**-2.0, 0.0))
    finish = dict(zip(FACES, scene.finishes, strict=True))
    walls = (("left", "right"), ("base", "tip"))
    return np.array(
        [1.0 if all(finish[f].metal is not None for f in pair) else total for pair in walls]
    )
