"""Images over the smooth faces of a flat pad on a window of another index.

The lower face of the window is seen through the bond: light goes down through it, is reflected, and
comes up through it again. Unfolded over the walls and the lower face that is one way through layers
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
    """The mirrors of a flat pad and the window under it, with a smooth lower face."""

    over_bond = True

    def __init__(self, scene: Scene) -> None:
        """Take the faces' places and both indices from the scene."""
        super().__init__(scene)
        self.bond = WindowBond(scene)

    def _way(self, image: mi.UInt32, a: mi.Point3f, p: mi.Point3f) -> LayeredWay:
        """Return the way over the lower face, as if ``image`` had that."""
        return way_through_bond(
            self.bond, mi.Vector3f(self.point(image, p) - a), a.z + p.z, 2.0 * self.bond.thickness
        )

    def _over_lower(self, image: mi.UInt32) -> mi.Bool:
        return self._digits(image)[2] > 0

    def line(self, image: mi.UInt32, a: mi.Point3f, p: mi.Point3f) -> tuple[mi.Vector3f, mi.Float]:
        """Return direction and spread, as of `MirrorImages.line`."""
        direction, squared = super().line(image, a, p)
        way, lower = self._way(image, a, p), self._over_lower(image)
        return dr.select(lower, way.direction, direction), dr.select(lower, way.spread, squared)

    def _weight(self, image: mi.UInt32, a: Vertex, y: Vertex) -> mi.Float:
        """Return what ``y`` may send to ``a`` by an image, without visibility; 0 without one.

        Walls are taken to reflect in the pad.
        """
        weight = super()._weight(image, a, y)
        way, lower = self._way(image, a.p, y.p), self._over_lower(image)
        return weight * dr.select(lower, dr.square(self.bond.passed(way.pad_cos)), 1.0)

    def _reflected(self, axis: int, digit: mi.UInt32, direction: mi.Vector3f) -> mi.Float:
        """Return what a mirror reflects of light that has ``direction`` at the coating."""
        if axis < 2:
            return super()._reflected(axis, digit, direction)
        cosine = self.bond.window_cos(direction.z)
        return self.reflectance(3 * axis + digit, cosine, self.bond.window)

    def index_at(self, p: mi.Point3f) -> mi.Float:
        """Return the index on the inner side of a face at ``p``."""
        return self.bond.index_at(p)

    def _at_bond(self, v: Vertex) -> mi.Bool:
        """Return whether ``v`` lies in the bond."""
        return v.delta & (dr.abs(v.n.z) > 1.0 - ON_FACE) & (dr.abs(v.p.z) < ON_FACE)

    def connected(self, y: Vertex) -> mi.Bool:
        """Return whether facets are connected to the images of ``y``: not if that is below."""
        return y.p.z > 0.0

    def follow(self, b: Vertex, d: mi.Vector3f, left: mi.UInt32, going: mi.Bool) -> FoldedLine:
        """Follow a line, through the bond where it meets that."""
        line, bond = super().follow(b, d, left, going), going & self._at_bond(b)
        onward, passed = through_bond(d, self.bond.ratio)
        # Down to the lower face, up to the vertex.
        meets = line.meets | (bond & (self._over_lower(left) == (d.z < 0)))
        below, rest = dr.select(bond, d.z < 0, b.p.z < 0), dr.select(bond, left, line.left)
        return FoldedLine(
            meets, meets & ((rest > 0) | below), rest, dr.select(bond, onward, line.d),
            dr.select(bond, passed, line.reflected), dr.select(bond, passed, line.chosen),
        )  # fmt: skip

    def extend(self, chain: ImageChain, v: Vertex, d: mi.Vector3f) -> ImageChain:
        """Return ``chain`` with what it meets at ``v``; the bond leaves it open."""
        following, bond = super().extend(chain, v, d), self._at_bond(v)
        _, passed = through_bond(d, self.bond.ratio)
        following.open = dr.select(bond, chain.open, following.open)
        following.chance = dr.select(bond, chain.chance * passed, following.chance)
        return following

    def broken(self, v: Vertex, refracted: mi.Bool) -> mi.Bool:
        """Return whether a chain ends at ``v``: the bond is passed and mirrors reflect."""
        return refracted ^ self._at_bond(v)
