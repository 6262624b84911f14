"""Images over the smooth faces of a flat pad.

A flat pad is a box of silicone: the folded line to an image meets every mirror within the face, as
in any box. Ways over two walls that face each other have none here.
"""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from render.cells.mirror_images import COSINE_MIN, ON_FACE, MirrorImages, metal_faces, mirror_faces
from render.paths.vertex import Vertex
from render.sampling.reservoirs import OneNumberReservoir
from render.sampling.streams import Numbers
from render.scene import FACES, Scene


class BoxImages(MirrorImages):
    """The mirrors of one flat pad: plane ``3 axis + digit``, with digits as in images."""

    sizes: tuple[int, ...] = (3, 3, 2)
    planes: tuple[tuple[int, ...], ...] = ((1, 2), (1, 2), (1,))
    """Of each axis, the digits of single mirrors."""

    def __init__(self, scene: Scene) -> None:
        """Take the faces' places from the scene."""
        low, high = scene.box.low, scene.box.high
        # Per axis the planes 1 and 2; 0 is no mirror.
        places = [0, low[0], high[0], 0, low[1], high[1], 0, low[2], 0]
        self.places = mi.Float(np.array(places, dtype=np.float32))
        self.index = mi.Float(scene.pad.index)
        mirrors = mirror_faces(scene)
        faces = [FACES.index(face) for face in ("left", "right", "base", "tip", "lower")]
        there = np.ones(9, dtype=np.float32)
        there[[1, 2, 4, 5, 7]] = mirrors[faces]
        # Images in faces that are no mirrors are never drawn.
        self.mirrors = None if mirrors.all() else mi.Float(there)
        metal = np.full(9, -1.0, dtype=np.float32)
        metal[[1, 2, 4, 5, 7]] = metal_faces(scene)[faces]
        self.metal = None if (metal < 0).all() else mi.Float(metal)
        dr.make_opaque(self.places, self.index, self.mirrors, self.metal)

    def point(self, image: mi.UInt32, p: mi.Point3f) -> mi.Point3f:
        """Return the image of ``p``."""
        result = mi.Point3f(p)
        for axis, digit in enumerate(self._digits(image)):
            place = dr.gather(mi.Float, self.places, 3 * axis + digit)
            result[axis] = dr.select(digit > 0, 2.0 * place - p[axis], p[axis])
        return result

    def folded(self, image: mi.UInt32, direction: mi.Vector3f) -> mi.Vector3f:
        """Return ``direction`` after all mirrors of ``image``."""
        result = mi.Vector3f(direction)
        for axis, digit in enumerate(self._digits(image)):
            result[axis] = dr.select(digit > 0, -direction[axis], direction[axis])
        return result

    def _weight(self, image: mi.UInt32, a: Vertex, y: Vertex) -> mi.Float:
        """Return what ``y`` may send to ``a`` by an image, without visibility; 0 without one."""
        direction, spread = self.line(image, a.p, y.p)
        sent = -self.arriving(image, direction, y.p)
        weight = dr.maximum(dr.dot(a.n, direction), COSINE_MIN) / dr.maximum(spread, 1e-6)
        facing = dr.maximum(dr.dot(y.n, sent), COSINE_MIN)
        weight *= dr.select(y.volume, 1.0, facing)
        for axis, digit in enumerate(self._digits(image)):
            reflected = self._reflected(axis, digit, direction)
            weight *= dr.select(digit > 0, reflected, 1.0)
            if self.mirrors is not None:
                weight *= dr.gather(mi.Float, self.mirrors, 3 * axis + digit)
        return weight

    def _reflected(self, axis: int, digit: mi.UInt32, direction: mi.Vector3f) -> mi.Float:
        """Return what a mirror reflects of light that has ``direction`` at the coating."""
        return self.reflectance(3 * axis + digit, direction[axis])

    @dr.syntax
    def draw(
        self, a: Vertex, y: Vertex, number: mi.Float, _candidates: Sequence[Numbers] = ()
    ) -> tuple[mi.UInt32, mi.Float]:
        """Return an image of ``y`` for ``a`` and its probability, for a uniform ``number``."""
        image = mi.UInt32(self.first)
        drawn = OneNumberReservoir.drawing(mi.UInt32(0), number)
        while image < self.count:
            drawn = drawn.offered(image, self._weight(image, a, y))
            image += 1
        return drawn.item, drawn.probability()

    @dr.syntax
    def probability(self, image: mi.UInt32, a: Vertex, y: Vertex) -> mi.Float:
        """Return the probability with which ``draw`` finds ``image``."""
        other, total = mi.UInt32(self.first), mi.Float(0.0)
        while other < self.count:
            total += self._weight(other, a, y)
            other += 1
        return self._weight(image, a, y) / total

    def _plane(self, mirror: mi.UInt32) -> mi.UInt32:
        """Return the number of the plane that an image over one mirror takes."""
        x, y, z = self._digits(mirror)
        return dr.select(x > 0, x, dr.select(y > 0, 3 + y, 6 + z))

    def _mirror(self, v: Vertex) -> mi.UInt32:
        """Return the image over the one mirror that ``v`` lies in, 0 if in none."""
        found = mi.UInt32(0)
        for axis in range(3):
            radix = int(np.prod(self.sizes[:axis]))
            flat = dr.abs(v.n[axis]) > 1.0 - ON_FACE
            for digit in self.planes[axis]:
                place = dr.gather(mi.Float, self.places, mi.UInt32(3 * axis + digit))
                there = flat & (dr.abs(v.p[axis] - place) < ON_FACE)
                found = dr.select(there & v.delta, digit * radix, found)
        return found
