"""Images over the smooth faces of a flat pad, behind a scattering layer over and over.

A flat pad is a box of silicone: the folded line to an image meets every mirror within the face, as
in any box. Between two smooth walls light goes to and fro, as between two mirrors; so it does in
the layer, between the lower face and the layer's upper one, which lies beside the coating and
reflects like the other faces. Each axis has images of every *order* k (Allen and Berkley 1979): |k|
is how often the light has been reflected, and the sign says in which of the two mirrors the facet
sees it. The *near* ones, of orders -1, 0 and 1, and 0 and -1 along z, are looked at one by one. The
others matter to light that a volume scatters, as no camera subpath ends there; what diffuse
surfaces send is found by camera subpaths instead.

There are too many to look at, and most carry nothing: so *candidates* are drawn from a few disjoint
parts of them, with heavy tails, and then one image in proportion to what it may send over its
probability as a candidate (resampled importance sampling, ``render.sampling.reservoirs``).
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
from render.scene import EDGES, FACES, Scene

ORDER_MAX = 31
"""Most reflections along one axis: what comes over more is left out."""
DIGITS = 2 * ORDER_MAX + 1
NEAR = (3, 3, 2)
"""Digits of the images that are looked at one by one."""
DEPTH_MAX = 6.0
"""Where optical depths are cut in the weights of candidates, which are never 0 then."""
UNMOVED = 0.4
"""What of the candidates has order 0 along an axis that is not theirs."""
MARGIN = 1e-3
"""mm by which the layer's upper face may miss its place in weights."""


def repeating_axes(scene: Scene) -> tuple[bool, bool, bool]:
    """Return along which axes a flat pad has images beyond the near ones.

    Across the pad these are axes of two mirrors; along z the layer's upper face is one, which has
    the finish of the pad. Without anything that scatters in a volume there are none.
    """
    if scene.diffuser is None or scene.diffuser.sigma_s == 0.0:
        return False, False, False
    mirrors = mirror_faces(scene)
    left, right, base, tip = (
        bool(mirrors[FACES.index(face)]) for face in ("left", "right", "base", "tip")
    )
    upper = scene.pad.roughness == 0.0 and scene.pad.index != 1.0
    return left and right, base and tip, upper


class BoxImages(MirrorImages):
    """The mirrors of one flat pad: plane ``3 axis + digit`` for the digits 1 and 2.

    Digits are 0 for order 0, then -1, 1, -2, 2, ...; plane 8 is the upper face of the layer.
    """

    sizes = (DIGITS, DIGITS, DIGITS)

    def __init__(self, scene: Scene) -> None:
        """Take the faces' places and the layer from the scene."""
        low, high = scene.box.low, scene.box.high
        self.axes = repeating_axes(scene)
        self.repeated = 2 * sum(self.axes)
        self.index = mi.Float(scene.pad.index)
        # Per axis the planes 1 and 2; 0 is no mirror.
        walls = [1, 2, 4, 5, 7]
        faces = [FACES.index(face) for face in ("left", "right", "base", "tip", "lower")]
        there = mirror_faces(scene)[faces].astype(np.float32)
        self.lower = bool(there[-1])
        places, mirrors, thickness = (np.zeros(9, dtype=np.float32) for _ in range(3))
        places[[*walls, 8]] = [low[0], high[0], low[1], high[1], low[2], high[2]]
        # Images in faces that are no mirrors are never drawn.
        mirrors[[*walls, 8]] = [*there, self.axes[2]]
        metal = np.full(9, -1.0, dtype=np.float32)
        metal[walls] = metal_faces(scene)[faces]
        layer = scene.diffuser
        sigma = 0.0 if layer is None else layer.sigma_s + layer.sigma_a
        rims = dict(zip(EDGES, scene.box.rims, strict=True))
        thickness[walls[:4]] = [rims[edge] for edge in ("left", "right", "base", "tip")]
        self.places, self.mirrors = mi.Float(places), mi.Float(mirrors)
        self.metal = None if (metal < 0).all() else mi.Float(metal)
        # Behind each plane, and the optical depth there and back at right angles.
        self.layer, self.depth = mi.Float(thickness), mi.Float(2.0 * sigma * thickness)
        dr.make_opaque(self.places, self.index, self.mirrors, self.metal, self.layer, self.depth)

    def _of(self, table: mi.Float, axis: int, plane: int) -> mi.Float:
        return dr.gather(mi.Float, table, mi.UInt32(3 * axis + plane))

    def point(self, image: mi.UInt32, p: mi.Point3f) -> mi.Point3f:
        """Return the image of ``p``."""
        result = mi.Point3f(p)
        for axis, digit in enumerate(self._digits(image)):
            low, high = (self._of(self.places, axis, plane) for plane in (1, 2))
            moved = dr.select(_odd(digit), low + high - p[axis], p[axis])
            result[axis] = moved + _order(digit) * (high - low)
        return result

    def folded(self, image: mi.UInt32, direction: mi.Vector3f) -> mi.Vector3f:
        """Return ``direction`` after all mirrors of ``image``."""
        result = mi.Vector3f(direction)
        for axis, digit in enumerate(self._digits(image)):
            result[axis] = dr.select(_odd(digit), -direction[axis], direction[axis])
        return result

    def _without(self, image: mi.UInt32, mirror: mi.UInt32) -> mi.UInt32:
        """Return ``image`` behind a mirror that it meets next; `count` or more where it does not.

        An order k is 1 - k behind the high mirror, and -1 - k behind the low one.
        """
        kept = []
        for digit, other in zip(self._digits(image), self._digits(mirror), strict=True):
            high = (digit & 1) == 0
            rest = dr.select(high, dr.select(digit > 2, digit - 3, 0), digit - 1)
            meets = (digit > 0) & (high == (other == 2))
            kept.append(dr.select(other == 0, digit, dr.select(meets, rest, self.count)))
        return self._combined(kept)

    def _weight(self, image: mi.UInt32, a: Vertex, y: Vertex) -> mi.Float:
        """Return what ``y`` may send to ``a`` by a near image, without visibility."""
        direction, spread = self.line(image, a.p, y.p)
        sent = -self.folded(image, direction)
        weight = dr.maximum(dr.dot(a.n, direction), COSINE_MIN) / dr.maximum(spread, 1e-6)
        facing = dr.maximum(dr.dot(y.n, sent), COSINE_MIN)
        weight *= dr.select(y.volume, 1.0, facing)
        for axis, digit in enumerate(self._digits(image)):
            plane = 3 * axis + digit
            reflected = self.reflectance(plane, direction[axis])
            reflected *= dr.gather(mi.Float, self.mirrors, plane)
            weight *= dr.select(digit > 0, reflected, 1.0)
        return weight

    @dr.syntax
    def draw(
        self, a: Vertex, y: Vertex, number: mi.Float, candidates: Sequence[Numbers] = ()
    ) -> tuple[mi.UInt32, mi.Float]:
        """Return an image of ``y`` for ``a``, and what its light is to be divided by.

        That is its weight over the sum of all: those of the near images,
        and for a ``y`` in a volume those of ``candidates``, which an event each draws.
        """
        near = mi.UInt32(1)
        drawn = OneNumberReservoir.drawing(mi.UInt32(0), number)
        while near < NEAR[0] * NEAR[1] * NEAR[2]:
            image = self._near(near)
            drawn = drawn.offered(image, self._weight(image, a, y))
            near += 1
        if y.volume:
            drawn = self._with_candidates(drawn, a, y, candidates)
        return drawn.item, drawn.probability()

    @dr.syntax
    def probability(self, image: mi.UInt32, a: Vertex, y: Vertex) -> mi.Float:
        """Return the probability with which ``draw`` finds ``image`` of a surface ``y``."""
        near, total, weight = mi.UInt32(1), mi.Float(0.0), mi.Float(0.0)
        while near < NEAR[0] * NEAR[1] * NEAR[2]:
            other = self._near(near)
            here = self._weight(other, a, y)
            total += here
            weight = dr.select(other == image, here, weight)
            near += 1
        return dr.select(weight > 0, weight / total, 0.0)

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
            for digit in (1, 2):
                place = dr.gather(mi.Float, self.places, mi.UInt32(3 * axis + digit))
                there = flat & (dr.abs(v.p[axis] - place) < ON_FACE)
                found = dr.select(there & v.delta, digit * radix, found)
        return found

    def _near(self, number: mi.UInt32) -> mi.UInt32:
        """Return one of the near images, by its number among them."""
        x, rest = number % NEAR[0], number // NEAR[0]
        return self._combined([x, rest % NEAR[1], rest // NEAR[1]])

    def _with_candidates(
        self, drawn: OneNumberReservoir, a: Vertex, y: Vertex, numbers: Sequence[Numbers]
    ) -> OneNumberReservoir:
        """Offer a candidate of the lowest and one of the other orders beyond, axis by axis.

        That axis is the last one along which the order is beyond those of near images, so along
        those behind it only near ones are drawn: each image belongs to one candidate.
        """
        following = iter(numbers)
        for axis in (axis for axis in range(3) if self.axes[axis]):
            for part in (0, 1):
                u, *others = next(following)
                digits = [mi.UInt32(0)] * 3
                far = _far_layer_order if axis == 2 else _far_order
                digits[axis], density = far(u, beyond=part == 1)
                for other, number in zip((i for i in range(3) if i != axis), others, strict=False):
                    if other < axis and self.axes[other]:
                        digits[other], probability = _any_order(number)
                    elif other < 2:
                        digits[other], probability = _near_order(number)
                    else:
                        down = number < 0.5 if self.lower else mi.Bool(False)
                        digits[2] = dr.select(down, mi.UInt32(1), 0)
                        probability = mi.Float(0.5 if self.lower else 1.0)
                    density *= probability
                image = self._combined(digits)
                here = self._repeated_weight(image, a, y)
                drawn = drawn.offered(image, here, here / density)
        return drawn

    def _repeated_weight(self, image: mi.UInt32, a: Vertex, y: Vertex) -> mi.Float:
        """Return what a vertex in a volume may send to ``a`` by an image of any order."""
        span = self.point(image, y.p) - a.p
        squared = dr.maximum(dr.squared_norm(span), 1e-6)
        direction = span * dr.rsqrt(squared)
        weight = dr.maximum(dr.dot(a.n, direction), COSINE_MIN) / squared
        depth = mi.Float(0.0)
        for axis, digit in enumerate(self._digits(image)):
            times, first = (digit + 1) // 2, (digit & 1) == 1
            cosine = dr.maximum(dr.abs(direction[axis]), 1e-3)
            # The mirror that the facet sees is met once more where the number is odd.
            low = dr.select(first, (times + 1) // 2, times // 2)
            for plane, met in ((1, low), (2, times - low)):
                reflected = self.reflectance(mi.UInt32(3 * axis + plane), cosine)
                carried = dr.power(reflected, mi.Float(met))
                carried *= self._of(self.mirrors, axis, plane)
                weight *= dr.select(met > 0, carried, 1.0)
                # Light begins in the layer of its last wall, or passes it altogether.
                last = (plane == 1) == (first == ((times & 1) == 1))
                passed = mi.Float(met) - dr.select((met > 0) & last, 1.0, 0.0)
                depth += passed * self._of(self.depth, axis, plane) / cosine
        weight *= dr.exp(-dr.minimum(depth, DEPTH_MAX))
        upper = self._digits(image)[2] > 1
        sent = -self.folded(image, direction)
        return dr.select(upper & ~self._meets_upper(y.p, sent), 0.0, weight)

    def _meets_upper(self, p: mi.Point3f, direction: mi.Vector3f) -> mi.Bool:
        """Return whether light from ``p`` first meets the height of the upper face in the layer."""
        lower, upper = (self._of(self.places, 2, plane) for plane in (1, 2))
        rising = dr.select(direction.z > 0, upper - p.z, upper - lower + p.z - lower)
        way = rising / dr.maximum(dr.abs(direction.z), 1e-6)
        inside = mi.Bool(False)
        for axis in (0, 1):
            low, high = (self._of(self.places, axis, plane) for plane in (1, 2))
            # Unfolded over the walls and folded again.
            turns = (p[axis] + way * direction[axis] - low) / (high - low)
            turns -= 2.0 * dr.floor(0.5 * turns)
            place = dr.minimum(turns, 2.0 - turns) * (high - low)
            inside |= place < self._of(self.layer, axis, 1) + MARGIN
            inside |= place > high - low - self._of(self.layer, axis, 2) - MARGIN
        return inside


def _odd(digit: mi.UInt32) -> mi.Bool:
    """Return whether the order of a digit is odd."""
    return (((digit + 1) // 2) & 1) == 1


def _order(digit: mi.UInt32) -> mi.Float:
    """Return the order of a digit."""
    times = mi.Float((digit + 1) // 2)
    return dr.select((digit & 1) == 1, -times, times)


def _digit(times: mi.UInt32, low: mi.Bool) -> mi.UInt32:
    """Return the digit of the order with so many reflections, seen in the low wall or the high."""
    return dr.select(times > 0, 2 * times - dr.select(low, mi.UInt32(1), 0), 0)


def _halved(u: mi.Float) -> tuple[mi.Bool, mi.Float]:
    """Return whether a uniform number is below a half, and a uniform number again."""
    low = u < 0.5
    return low, dr.select(low, 2.0 * u, 2.0 * u - 1.0)


def _far_order(u: mi.Float, *, beyond: bool) -> tuple[mi.UInt32, mi.Float]:
    """Return the digit of an order of 2, or ``beyond`` that, and its probability.

    From 3 on a number m of reflections has the probability 2 / (m (m - 1)).
    """
    low, u = _halved(u)
    if not beyond:
        return _digit(mi.UInt32(2), low), mi.Float(0.5)
    times = dr.minimum(1 + mi.UInt32(2.0 / (1.0 - u)), ORDER_MAX)
    m = mi.Float(times)
    probability = dr.select(times == ORDER_MAX, 2.0 / (m - 1.0), 2.0 / (m * (m - 1.0)))
    return _digit(times, low), 0.5 * probability


def _far_layer_order(u: mi.Float, *, beyond: bool) -> tuple[mi.UInt32, mi.Float]:
    """Return the digit of an order over the upper face, and its probability.

    The first is -2, over the upper face and then the lower one, and 1, -3, 2, -4, ... are
    ``beyond`` it; the j-th of these has the probability 1 / (j (j + 1)).
    """
    if not beyond:
        return mi.UInt32(3), mi.Float(1.0)
    j = dr.minimum(mi.UInt32(1.0 / (1.0 - u)), 2 * ORDER_MAX - 3)
    m = mi.Float(j)
    probability = dr.select(j == 2 * ORDER_MAX - 3, 1.0 / m, 1.0 / (m * (m + 1.0)))
    # Digits 2, 5, 4, 7, 6, ...
    digit = dr.select((j & 1) == 1, j + 1, j + 3)
    return digit, probability


def _any_order(u: mi.Float) -> tuple[mi.UInt32, mi.Float]:
    """Return the digit of any order, and its probability.

    Not of 0 it is 1 / (m (m + 1)) for both orders of m reflections.
    """
    moved = u >= UNMOVED
    low, v = _halved((u - UNMOVED) / (1.0 - UNMOVED))
    times = dr.minimum(mi.UInt32(1.0 / dr.maximum(1.0 - v, 1e-6)), ORDER_MAX)
    m = mi.Float(times)
    probability = dr.select(times == ORDER_MAX, 1.0 / m, 1.0 / (m * (m + 1.0)))
    probability *= 0.5 * (1.0 - UNMOVED)
    return dr.select(moved, _digit(times, low), 0), dr.select(moved, probability, UNMOVED)


def _near_order(u: mi.Float) -> tuple[mi.UInt32, mi.Float]:
    """Return the digit of an order of -1, 0 or 1, and its probability."""
    moved = u >= UNMOVED
    low, _ = _halved((u - UNMOVED) / (1.0 - UNMOVED))
    digit = dr.select(moved, dr.select(low, mi.UInt32(1), 2), 0)
    return digit, dr.select(moved, 0.5 * (1.0 - UNMOVED), UNMOVED)
