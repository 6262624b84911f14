"""Images over the bond of a flat pad and a window of another index.

What lies on the window's faces is seen through the bond, and so is what its lower face shows of
pad and window where it is smooth. Unfolded over walls and lower face that is one way through layers
of two indices, bent by Snell's law at the bond, and in a plane with the bond's normal; Newton's
method finds it. Along the faces wave vectors stay, so the order of layers does not matter. Walls
reflect on either side of the bond, and what they reflect depends on which.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from render.cells.bond_optics import LayeredWay, WindowBond, through_bond, way_through_bond
from render.cells.box_images import BoxImages
from render.cells.mirror_images import ON_FACE, FoldedLine, ImageChain
from render.paths.vertex import Vertex
from render.scene import Scene


class BondedImages(BoxImages):
    """The mirrors of a flat pad and the window under it; image 0 is seen through the bond alone."""

    first = 0

    def __init__(self, scene: Scene) -> None:
        """Take the faces' places and both indices from the scene."""
        super().__init__(scene)
        self.bond = WindowBond(scene)

    def _way(self, image: mi.UInt32, a: mi.Point3f, p: mi.Point3f) -> LayeredWay:
        """Return the way through the bond; to points of the pad that is over the lower face."""
        above, depth = dr.maximum(p.z, 0.0), dr.minimum(p.z, 0.0)
        there_and_back = 2.0 * self.bond.thickness + depth
        straight = (p.z < 0) & ~self._over_lower(image)
        window = dr.select(straight, -depth, there_and_back)
        across = mi.Vector3f(self.point(image, p) - a)
        return way_through_bond(self.bond, across, a.z + above, window)

    def _over_lower(self, image: mi.UInt32) -> mi.Bool:
        return self._digits(image)[2] > 0

    def line(self, image: mi.UInt32, a: mi.Point3f, p: mi.Point3f) -> tuple[mi.Vector3f, mi.Float]:
        """Return direction and spread, as of `MirrorImages.line`."""
        direction, squared = super().line(image, a, p)
        way, below = self._way(image, a, p), p.z < 0
        steeper = way.window_cos / dr.maximum(way.pad_cos, 1e-6)
        spread = way.spread * dr.select(below, steeper, 1.0)
        bent = self._over_lower(image) | below
        return dr.select(bent, way.direction, direction), dr.select(bent, spread, squared)

    def arriving(self, image: mi.UInt32, direction: mi.Vector3f, p: mi.Point3f) -> mi.Vector3f:
        """Return how a line arrives, as of `MirrorImages.arriving`."""
        below, _ = through_bond(direction, self.bond.ratio)
        return self.folded(image, dr.select(p.z < 0, below, direction))

    def reaches(self, image: mi.UInt32, p: mi.Point3f) -> mi.Bool:
        """Return whether a line is bent or reflected on its way to ``p``."""
        return (image > 0) | (p.z < 0)

    def square_of_index(self, p: mi.Point3f) -> mi.Float:
        """Return the squared index at ``p`` over that of the pad."""
        return dr.select(p.z < 0, dr.square(self.bond.ratio), 1.0)

    def _weight(self, image: mi.UInt32, a: Vertex, y: Vertex) -> mi.Float:
        """Return what ``y`` may send to ``a`` by an image, without visibility; 0 without one.

        Walls are taken to reflect in the pad.
        """
        weight = super()._weight(image, a, y)
        way, below = self._way(image, a.p, y.p), y.p.z < 0
        passed = self.bond.passed(way.pad_cos)
        twice = dr.select(self._over_lower(image), dr.square(passed), 1.0)
        weight *= dr.select(below, passed, twice)
        return dr.select(self.reaches(image, y.p), weight, 0.0)

    def _reflected(self, axis: int, digit: mi.UInt32, direction: mi.Vector3f) -> mi.Float:
        """Return what a mirror reflects of light that has ``direction`` at the coating."""
        if axis < 2:
            return super()._reflected(axis, digit, direction)
        cosine = self.bond.window_cos(direction.z)
        return self.reflectance(3 * axis + digit, cosine, self.bond.window)

    def index_at(self, p: mi.Point3f) -> mi.Float:
        """Return the index on the inner side of a face at ``p``."""
        return self.bond.index_at(p)

    def at_bond(self, v: Vertex) -> mi.Bool:
        """Return whether ``v`` lies in the bond."""
        return v.delta & (dr.abs(v.n.z) > 1.0 - ON_FACE) & (dr.abs(v.p.z) < ON_FACE)

    def follow(
        self, b: Vertex, d: mi.Vector3f, left: mi.UInt32, y: Vertex, going: mi.Bool
    ) -> FoldedLine:
        """Follow a line, through the bond where it meets that."""
        line, bond = super().follow(b, d, left, y, going), going & self.at_bond(b)
        onward, passed = through_bond(d, self.bond.ratio)
        # Down to the lower face or to what lies below, else up.
        ends_below = y.p.z < 0
        meets = line.meets | (bond & ((self._over_lower(left) | ends_below) == (d.z < 0)))
        below, rest = dr.select(bond, d.z < 0, b.p.z < 0), dr.select(bond, left, line.left)
        return FoldedLine(
            meets, meets & ((rest > 0) | (below != ends_below)), rest,
            dr.select(bond, onward, line.d), dr.select(bond, passed, line.reflected),
            dr.select(bond, passed, line.chosen),
        )  # fmt: skip

    def extend(self, chain: ImageChain, v: Vertex, d: mi.Vector3f) -> ImageChain:
        """Return ``chain`` with what it meets at ``v``; the bond leaves it open."""
        following, bond = super().extend(chain, v, d), self.at_bond(v)
        _, passed = through_bond(d, self.bond.ratio)
        following.open = dr.select(bond, chain.open, following.open)
        following.chance = dr.select(bond, chain.chance * passed, following.chance)
        return following

    def broken(self, v: Vertex, refracted: mi.Bool) -> mi.Bool:
        """Return whether a chain ends at ``v``: the bond is passed and mirrors reflect."""
        return refracted ^ self.at_bond(v)
