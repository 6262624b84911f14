"""Connections over the smooth faces of a pad, by the image method.

Where faces of a pad are smooth or metal, light from a vertex ``y`` reaches the coating over the
lower face, over a wall, or over several of them, on the straight line to an image of ``y``. No
random direction finds an image of a volume, or of a lobe on a rough face, often enough; this
connects to one of them, drawn in proportion to what it may send. Ways that have no image are left
to camera subpaths, which reflect by chance and compete in the balance heuristic for the others as
well.

Where the mirrors are is said by the faces of the pad (``render.pad``). On a flat one images lie in
walls, in the lower face and in all combinations of these, on a bent one in a wall, in an end or a
strip of the lower face, and in both; where light meets a mirror twice, or two strips, has no image.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from render.pad import PlaneFace
from render.paths.connect import density_at, optical_depth, strategies_before, trace_to_surface
from render.paths.vertex import Vertex, evaluate_scattering
from render.paths.walk import GuidingDistribution, SubpathState, guided_pdf
from render.sampling.reservoirs import OneNumberReservoir

ON_FACE = 1e-3
"""Distance (mm), and that of unit normals, by which a vertex on a face may miss its plane."""
COSINE_MIN = 0.1
"""Least cosine in the weights by which images are drawn: facets are tilted, volumes have none."""
NUMBERS = 10
"""Of a mirror: normal and plane, direction along it, where it begins and ends, metal or -1."""
LONGEST = 1e6
"""mm along a wall, which is bounded by other faces."""


@dataclass
class ImageChain:
    """The mirrors that a camera subpath has met behind the facet (a Dr.Jit PyTree).

    ``image`` is the combination of them and ``open`` whether it may become an image connection;
    ``chance`` is that of being reflected by them all, ``depth`` the optical depth per channel so
    far and ``d_vcm`` that of the facet, 1 / density of the sampled direction.
    """

    image: mi.UInt32
    open: mi.Bool
    chance: mi.Float
    depth: mi.Spectrum
    d_vcm: mi.Float

    @staticmethod
    def closed() -> ImageChain:
        """Return the chain of a subpath that has not met the facet."""
        return ImageChain(mi.UInt32(0), mi.Bool(False), mi.Float(1), mi.Spectrum(0), mi.Float(0))


@dataclass
class FoldedLine:
    """How a line to an image goes on behind a surface (a Dr.Jit PyTree).

    Whether it ``meets`` one that is on its way and goes ``on`` to another, the mirrors that are
    ``left``, its direction ``d``, what the surface leaves of the light and with what chance a path
    follows.
    """

    meets: mi.Bool
    on: mi.Bool
    left: mi.UInt32
    d: mi.Vector3f
    reflected: mi.Float
    chosen: mi.Float


class MirrorImages:
    """The mirrors of one pad: those of its plane faces that are smooth or metal.

    An image takes of each group of faces (`render.pad.plane_faces`) one mirror or none; their order
    along the way does not matter, as groups are at right angles. Image 0 takes none, as mirror 0 is
    none.
    """

    def __init__(self, groups: list[list[PlaneFace]], index: float) -> None:
        """List mirrors of ``groups`` of faces beside silicone of this ``index``, and images."""
        mirrors = [[face for face in group if face.is_mirror] for group in groups]
        numbers, rows, alone, group_of = [], [[0.0] * NUMBERS], [0], [0]
        stride = 1
        for group, faces in enumerate(mirrors):
            first = len(rows)
            numbers.append([0, *range(first, first + len(faces))])
            for digit, face in enumerate(faces, 1):
                rows.append(_row(face))
                alone.append(digit * stride)
                group_of.append(group)
            stride *= len(faces) + 1
        # The first group varies fastest.
        taken = np.array([each[::-1] for each in itertools.product(*numbers[::-1])])
        self.groups = len(groups)
        self.metal = any(face.finish.metal is not None for group in mirrors for face in group)
        self.index, self.count = mi.Float(index), mi.UInt32(stride)
        self.mirrors = mi.UInt32(len(rows))
        self.rows = mi.Float(np.array(rows, dtype=np.float32).ravel())
        self.taken, self.alone, self.group_of = (
            mi.UInt32(np.array(each, dtype=np.uint32).ravel()) for each in (taken, alone, group_of)
        )
        dr.make_opaque(
            self.index, self.count, self.mirrors, self.rows, self.taken, self.alone, self.group_of
        )

    def _mirrors_of(self, image: mi.UInt32) -> list[mi.UInt32]:
        """Return the mirror of each group that an image takes, 0 for none."""
        return [
            dr.gather(mi.UInt32, self.taken, self.groups * image + i) for i in range(self.groups)
        ]

    def _inward(self, mirror: mi.UInt32) -> mi.Vector3f:
        """Return a mirror's normal into the pad; 0 for none."""
        return mi.Vector3f(*(self._number(mirror, i) for i in range(3)))

    def _number(self, mirror: mi.UInt32, column: int) -> mi.Float:
        return dr.gather(mi.Float, self.rows, NUMBERS * mirror + column)

    def _across(self, mirror: mi.UInt32, p: mi.Point3f) -> tuple[mi.Float, mi.Float]:
        """Return where ``p`` is along a mirror, from where it begins, and how far inside; mm."""
        along = mi.Vector3f(*(self._number(mirror, i) for i in (4, 5, 6)))
        inside = dr.dot(p, self._inward(mirror)) - self._number(mirror, 3)
        return dr.dot(p, along) - self._number(mirror, 7), inside

    def point(self, image: mi.UInt32, p: mi.Point3f) -> mi.Point3f:
        """Return the image of ``p``."""
        result = mi.Point3f(p)
        for mirror in self._mirrors_of(image):
            result -= 2.0 * self._across(mirror, p)[1] * self._inward(mirror)
        return result

    def folded(self, image: mi.UInt32, direction: mi.Vector3f) -> mi.Vector3f:
        """Return ``direction`` after all mirrors of ``image``."""
        result = mi.Vector3f(direction)
        for mirror in self._mirrors_of(image):
            inward = self._inward(mirror)
            result -= 2.0 * dr.dot(direction, inward) * inward
        return result

    def line(self, image: mi.UInt32, a: mi.Point3f, p: mi.Point3f) -> tuple[mi.Vector3f, mi.Float]:
        """Return the direction from ``a`` to the image of ``p``, and what light spreads to there.

        That is the area across the way per solid angle at ``a`` (mm^2 / sr).
        """
        span = self.point(image, p) - a
        squared = dr.maximum(dr.squared_norm(span), 1e-12)
        return span * dr.rsqrt(squared), squared

    def _weight(self, image: mi.UInt32, a: Vertex, y: Vertex) -> mi.Float:
        """Return what ``y`` may send to ``a`` by an image, without visibility; 0 without one."""
        direction, squared = self.line(image, a.p, y.p)
        sent = -self.folded(image, direction)
        weight = dr.maximum(dr.dot(a.n, direction), COSINE_MIN) / dr.maximum(squared, 1e-6)
        weight *= dr.select(y.volume, 1.0, dr.maximum(dr.dot(y.n, sent), COSINE_MIN))
        for mirror in self._mirrors_of(image):
            # Where the line crosses the strip.
            (along_a, inside_a), (along_y, inside_y) = (self._across(mirror, v.p) for v in (a, y))
            crossed = along_a * inside_y + along_y * inside_a
            length = self._number(mirror, 8) * (inside_a + inside_y)
            meets = (inside_a > 0) & (inside_y > 0) & (crossed >= 0) & (crossed <= length)
            reflected = self.reflectance(mirror, dr.dot(direction, self._inward(mirror)))
            weight *= dr.select(mirror > 0, dr.select(meets, reflected, 0.0), 1.0)
        return weight

    @dr.syntax
    def draw(self, a: Vertex, y: Vertex, number: mi.Float) -> tuple[mi.UInt32, mi.Float]:
        """Return an image of ``y`` for ``a`` and its probability, for a uniform ``number``."""
        image = mi.UInt32(1)
        drawn = OneNumberReservoir.drawing(mi.UInt32(0), number)
        while image < self.count:
            drawn = drawn.offered(image, self._weight(image, a, y))
            image += 1
        return drawn.item, drawn.probability()

    @dr.syntax
    def probability(self, image: mi.UInt32, a: Vertex, y: Vertex) -> mi.Float:
        """Return the probability with which ``draw`` finds ``image``."""
        other, total, weight = mi.UInt32(1), mi.Float(0.0), mi.Float(0.0)
        while other < self.count:
            here = self._weight(other, a, y)
            total += here
            weight = dr.select(other == image, here, weight)
            other += 1
        return dr.select(weight > 0, weight / total, 0.0)

    @dr.syntax
    def mirror_at(self, v: Vertex) -> mi.UInt32:
        """Return the mirror that ``v`` lies in, 0 if in none."""
        # Neighbors are nearly parallel: the one whose normal is nearest.
        found, best, mirror = mi.UInt32(0), mi.Float(ON_FACE), mi.UInt32(1)
        while mirror < self.mirrors:
            (along, inside), inward = self._across(mirror, v.p), self._inward(mirror)
            there = (dr.abs(inside) < ON_FACE) & (along > -ON_FACE)
            there &= along < self._number(mirror, 8) + ON_FACE
            # Normals point out of boundaries, and into the pad from metal.
            turned = dr.norm(inward - dr.mulsign(1.0, dr.dot(v.n, inward)) * mi.Vector3f(v.n))
            nearer = there & (turned < best)
            best = dr.select(nearer, turned, best)
            found = dr.select(nearer, mirror, found)
            mirror += 1
        return dr.select(v.delta, found, 0)

    def follow(self, b: Vertex, d: mi.Vector3f, left: mi.UInt32, going: mi.Bool) -> FoldedLine:
        """Follow a line along ``d`` at ``b``, before which the mirrors of ``left`` lie."""
        mirror = self.mirror_at(b)
        meets = going & (mirror > 0) & (self._in_group_of(mirror, left) == mirror)
        alone = dr.gather(mi.UInt32, self.alone, mirror)
        rest = dr.select(meets, left - alone, 0)
        reflected, chosen = self.met_at(mirror, dr.dot(b.n, d))
        return FoldedLine(meets, meets & (rest > 0), rest, self.folded(alone, d), reflected, chosen)

    def extend(self, chain: ImageChain, v: Vertex, d: mi.Vector3f) -> ImageChain:
        """Return ``chain`` with the mirror at ``v``, at which a camera subpath arrived by ``d``."""
        mirror = self.mirror_at(v)
        fits = chain.open & (mirror > 0) & (self._in_group_of(mirror, chain.image) == 0)
        _, chosen = self.met_at(mirror, dr.dot(v.n, d))
        image = chain.image + dr.select(fits, dr.gather(mi.UInt32, self.alone, mirror), 0)
        return ImageChain(image, fits, chain.chance * chosen, chain.depth, chain.d_vcm)

    def _in_group_of(self, mirror: mi.UInt32, image: mi.UInt32) -> mi.UInt32:
        """Return the mirror that an image takes of the group of ``mirror``."""
        group = dr.gather(mi.UInt32, self.group_of, mirror)
        return dr.gather(mi.UInt32, self.taken, self.groups * image + group)

    def reflectance(self, mirror: mi.UInt32, cosine: mi.Float) -> mi.Float:
        """Return what a mirror reflects in the pad; ``cosine`` is that of incidence."""
        reflected = mi.fresnel(-dr.abs(cosine), self.index)[0]
        if not self.metal:
            return reflected
        metal = self._number(mirror, 9)
        return dr.select(metal < 0, reflected, metal)

    def met_at(self, mirror: mi.UInt32, cosine: mi.Float) -> tuple[mi.Float, mi.Float]:
        """Return what a mirror reflects, and the chance that a path is reflected.

        It is reflected by chance where it could leave the pad, and always by metal.
        """
        reflected = self.reflectance(mirror, cosine)
        if not self.metal:
            return reflected, reflected
        return reflected, dr.select(self._number(mirror, 9) >= 0, 1.0, reflected)

    @dr.syntax
    def connect(
        self, scene: mi.Scene, y: Vertex, a: Vertex, number: mi.Float, active: mi.Bool,
        guiding: GuidingDistribution, returning: GuidingDistribution | None = None,
    ) -> mi.Spectrum:  # fmt: skip
        """Return the MIS-weighted light that facet ``a`` gets from ``y`` over one image.

        A connection (``render.paths.connect.connect_vertices``) through boundaries that pass their
        reflectance, and camera subpaths by the chance of being reflected. Light subpaths do not
        sample facets of the camera, so no strategy behind ``a`` competes.
        """
        active = active & (y.weight > 0) & (a.weight > 0)
        image, probability = self.draw(a, y, number)
        direction, spread = self.line(image, a.p, y.p)
        w = -self.folded(image, direction)
        f_a, p_a, _ = evaluate_scattering(a, direction, mi.TransportMode.Radiance, active)
        p_a = guided_pdf(guiding, a, direction, p_a)
        f_y, _, r_y = evaluate_scattering(y, w, mi.TransportMode.Importance, active)
        active = active & (probability > 0) & (dr.max(f_a) > 0) & (dr.max(f_y) > 0)
        # --------------------- Along the folded line, mirror by mirror ----------------
        here, d = a, mi.Vector3f(direction)
        left, depth = mi.UInt32(image), mi.Spectrum(0.0)
        reflectance, chance = mi.Float(1.0), mi.Float(1.0)
        going = mi.Bool(active)
        while going:
            b, further, hit = trace_to_surface(scene, here, d, going)
            line = self.follow(b, d, left, going & hit)
            meets = line.meets
            active = active & (~going | meets)
            reflectance *= dr.select(meets, line.reflected, 1.0)
            chance *= dr.select(meets, line.chosen, 1.0)
            depth += dr.select(meets, further, 0.0)
            d = dr.select(meets, line.d, d)
            left = dr.select(meets, line.left, left)
            here = dr.select(meets, b, here)
            going = line.on
        last_depth, clear = optical_depth(scene, y, here, active)
        transmittance = dr.exp(-depth - last_depth)
        # --------------------- Balance heuristic --------------------------------------
        camera_y = density_at(y, w, p_a * chance, transmittance, active) / spread
        strategies = probability + camera_y * strategies_before(y, r_y, returning)
        value = y.beta * f_y * f_a * a.beta * transmittance * reflectance / spread
        value *= y.weight * a.weight / strategies
        return dr.select(active & clear, value, 0.0)

    @dr.syntax
    def arrive(
        self, chain: ImageChain, v: Vertex, state: SubpathState, facet: Vertex, connected: mi.Bool
    ) -> tuple[ImageChain, mi.Float]:
        """Follow a camera subpath to vertex ``v``; return the chain and ``d_vcm`` of ``v``.

        The latter is the ratio of image connections to the facet over what the camera subpath
        does, where there are any: 0 otherwise. ``connected``: light subpaths connect ``v``.
        """
        useful = chain.open & connected & (chain.image > 0)
        probability = mi.Float(0.0)
        if useful:
            probability = self.probability(chain.image, facet, v)
        _, spread = self.line(chain.image, facet.p, v.p)
        transmittance = dr.exp(-chain.depth - state.depth)
        density = density_at(v, state.d, chain.chance, transmittance, useful)
        d_vcm = chain.d_vcm * probability * spread / density
        d_vcm = dr.select(useful, d_vcm, 0.0)
        following = self.extend(chain, v, state.d)
        following.depth = chain.depth + state.depth
        return following, d_vcm


def _row(face: PlaneFace) -> list[float]:
    """Return the `NUMBERS` of a mirror."""
    plane, begin = float(face.inward @ face.point), float(face.along @ face.point)
    metal = -1.0 if face.finish.metal is None else face.finish.metal
    return [*face.inward, plane, *face.along, begin, min(face.length, LONGEST), metal]
