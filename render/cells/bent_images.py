"""Images over the smooth faces of a bent pad.

The lower face of a bent pad is a row of plane strips, as its meshes are, so each strip is a mirror
with an exact image. The folded line to it meets the strip or misses it; where several strips are
met, as in any concave mirror, each is a way of its own. Across the pad the walls stay planes at
right angles to all of that. Ways over two strips, or over a strip and an end, have no image here.
"""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from render.cells.mirror_images import COSINE_MIN, ON_FACE, MirrorImages, metal_faces, mirror_faces
from render.geometry.bending import bend_points
from render.geometry.meshes import pad_grid
from render.paths.vertex import Vertex
from render.sampling.reservoirs import OneNumberReservoir
from render.sampling.streams import Numbers
from render.scene import FACES, Scene

NUMBERS = 5
"""Of a segment: a point (y, z) of it, its direction, its length."""


class BentImages(MirrorImages):
    """The mirrors of one bent pad: walls across it, and *segments* of its outline from the side.

    Those are its ends and the strips of its lower face, each as far as it is smooth or metal. A
    wall's number is its plane's, and those of segments follow.
    """

    def __init__(self, scene: Scene, bend: float, indented: bool) -> None:
        """Take the faces' places from the meshes at ``bend`` radians."""
        y = pad_grid(scene, bend, indented).y
        outline = np.column_stack(
            [np.zeros(len(y) + 2), np.r_[y[0], y, y[-1]], np.zeros(len(y) + 2)]
        )
        outline[[0, -1], 2] = scene.pad.thickness
        outline = bend_points(scene, outline, bend)[:, 1:]
        # The pad is on the left of the way along them.
        span = np.diff(outline, axis=0)
        length = np.linalg.norm(span, axis=1, keepdims=True)
        segments = np.concatenate([outline[:-1], span / length, length], axis=1)
        faces = [FACES.index(face) for face in ("left", "right", "base", "tip", "lower")]
        left, right, base, tip, lower = mirror_faces(scene)[faces]
        smooth = np.r_[base, np.full(len(y) - 1, lower), tip]
        segments = segments[smooth]
        metals = metal_faces(scene)[faces]
        ends = np.r_[metals[2], np.full(len(y) - 1, metals[4]), metals[3]][smooth]
        # Neither number 0 is a mirror.
        metal = np.r_[-1.0, metals[:2], -1.0, ends]
        self.sizes = (3, len(segments) + 1)
        # Number 0 is no mirror.
        self.walls = mi.Float([0.0, *scene.box.low[:1], *scene.box.high[:1]])
        self.there = mi.Float([1.0, float(left), float(right)])
        self.segments = mi.Float(np.r_[np.zeros((1, NUMBERS)), segments].astype(np.float32).ravel())
        self.index = mi.Float(scene.pad.index)
        self.segment_count = mi.UInt32(len(segments) + 1)
        self.metal = None if (metal < 0).all() else mi.Float(metal.astype(np.float32))
        dr.make_opaque(
            self.walls, self.there, self.segments, self.index, self.segment_count, self.metal
        )

    def _across(self, number: mi.UInt32, p: mi.Point3f) -> tuple[mi.Float, mi.Float, mi.Float]:
        """Return where ``p`` is along segment ``number``, how far inside, and the length."""
        y, z, along_y, along_z, length = (
            dr.gather(mi.Float, self.segments, NUMBERS * number + i) for i in range(NUMBERS)
        )
        y, z = p.y - y, p.z - z
        return y * along_y + z * along_z, z * along_y - y * along_z, length

    def _inward(self, number: mi.UInt32) -> mi.Vector3f:
        """Return the normal of segment ``number`` into the pad; 0 for none."""
        along_y, along_z = (
            dr.gather(mi.Float, self.segments, NUMBERS * number + i) for i in (2, 3)
        )
        return mi.Vector3f(0.0, -along_z, along_y)

    def point(self, image: mi.UInt32, p: mi.Point3f) -> mi.Point3f:
        """Return the image of ``p``."""
        wall, segment = self._digits(image)
        _, inside, _ = self._across(segment, p)
        result = p - 2.0 * inside * self._inward(segment)
        result.x = dr.select(wall > 0, 2.0 * dr.gather(mi.Float, self.walls, wall) - p.x, p.x)
        return result

    def folded(self, image: mi.UInt32, direction: mi.Vector3f) -> mi.Vector3f:
        """Return ``direction`` after all mirrors of ``image``."""
        wall, segment = self._digits(image)
        normal = self._inward(segment)
        result = direction - 2.0 * dr.dot(direction, normal) * normal
        result.x = dr.select(wall > 0, -direction.x, direction.x)
        return result

    def _weight(self, wall: int, segment: mi.UInt32, a: Vertex, y: Vertex) -> mi.Float:
        """Return what ``y`` may send to ``a`` by an image, without visibility; 0 without one."""
        image = wall + self.sizes[0] * segment
        span = self.point(image, y.p) - a.p
        squared = dr.maximum(dr.squared_norm(span), 1e-6)
        direction = span * dr.rsqrt(squared)
        sent = -self.folded(image, direction)
        weight = dr.maximum(dr.dot(a.n, direction), COSINE_MIN) / squared
        weight *= dr.select(y.volume, 1.0, dr.maximum(dr.dot(y.n, sent), COSINE_MIN))
        if wall > 0:
            number = mi.UInt32(wall)
            weight *= self.reflectance(number, direction.x)
            weight *= dr.gather(mi.Float, self.there, number)
        # Where the line crosses the segment.
        along_a, inside_a, length = self._across(segment, a.p)
        along_y, inside_y, _ = self._across(segment, y.p)
        inside = inside_a + inside_y
        met = along_a * inside_y + along_y * inside_a
        meets = (inside_a > 0) & (inside_y > 0) & (met >= 0) & (met <= length * inside)
        cosine = dr.dot(direction, self._inward(segment))
        by_segment = self.reflectance(self.sizes[0] + segment, cosine)
        # Without wall and segment it is no image.
        alone = 1.0 if wall > 0 else 0.0
        return weight * dr.select(segment > 0, dr.select(meets, by_segment, 0.0), alone)

    def _plane(self, mirror: mi.UInt32) -> mi.UInt32:
        """Return the number of the plane that an image over one mirror takes."""
        wall, segment = self._digits(mirror)
        return dr.select(wall > 0, wall, self.sizes[0] + segment)

    @dr.syntax
    def draw(
        self, a: Vertex, y: Vertex, number: mi.Float, _candidates: Sequence[Numbers] = ()
    ) -> tuple[mi.UInt32, mi.Float]:
        """Return an image of ``y`` for ``a`` and its probability, for a uniform ``number``."""
        segment = mi.UInt32(0)
        drawn = OneNumberReservoir.drawing(mi.UInt32(0), number)
        while segment < self.segment_count:
            for wall in range(self.sizes[0]):
                image = wall + self.sizes[0] * segment
                drawn = drawn.offered(image, self._weight(wall, segment, a, y))
            segment += 1
        return drawn.item, drawn.probability()

    @dr.syntax
    def probability(self, image: mi.UInt32, a: Vertex, y: Vertex) -> mi.Float:
        """Return the probability with which ``draw`` finds ``image``."""
        segment, total, weight = mi.UInt32(0), mi.Float(0.0), mi.Float(0.0)
        while segment < self.segment_count:
            for wall in range(self.sizes[0]):
                here = self._weight(wall, segment, a, y)
                total += here
                weight = dr.select(image == wall + self.sizes[0] * segment, here, weight)
            segment += 1
        return dr.select(weight > 0, weight / total, 0.0)

    @dr.syntax
    def _mirror(self, v: Vertex) -> mi.UInt32:
        """Return the image over the one mirror that ``v`` lies in, 0 if in none."""
        found, best = mi.UInt32(0), mi.Float(ON_FACE)
        flat = dr.abs(v.n.x) > 1.0 - ON_FACE
        for wall in (1, 2):
            number = mi.UInt32(wall)
            there = dr.gather(mi.Float, self.there, number) > 0
            there &= dr.abs(v.p.x - dr.gather(mi.Float, self.walls, number)) < ON_FACE
            found = dr.select(flat & there, number, found)
        # Neighbors are nearly parallel: the one whose normal is nearest.
        segment = mi.UInt32(1)
        while segment < self.segment_count:
            along, inside, length = self._across(segment, v.p)
            there = (dr.abs(inside) < ON_FACE) & (along > -ON_FACE) & (along < length + ON_FACE)
            turned = dr.norm(v.n + self._inward(segment))
            nearer = ~flat & there & (turned < best)
            best = dr.select(nearer, turned, best)
            found = dr.select(nearer, self.sizes[0] * segment, found)
            segment += 1
        return dr.select(v.delta, found, 0)
