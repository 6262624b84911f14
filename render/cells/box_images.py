"""Connections over the smooth faces of a flat pad, by the image method.

A flat pad is a box of silicone. Where faces of it are smooth, light from a vertex ``y`` reaches the
coating over the lower face, over a wall, or over several of them, on the straight line to an image
of ``y``: the folded line meets every mirror within the face, as in any box. No random direction
finds a mirror image that is exact; this connects to one of them, drawn in proportion to what it may
send. Ways over two walls that face each other are left to camera subpaths, which reflect by chance
and compete in the balance heuristic for the others as well.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from render.paths.connect import arrival_density, optical_depth, trace_to_surface
from render.paths.vertex import Vertex, area_factor, evaluate_scattering
from render.paths.walk import GuidingDistribution, SubpathState
from render.scene import FACES, Scene

IMAGES = 18
"""Combinations of mirrors: x, y and z each none or one of theirs; 0 is no mirror at all."""
ON_FACE = 1e-3
"""Distance (mm), and cosine's distance from 1, by which a vertex on a face may miss its plane."""
COSINE_MIN = 0.1
"""Least cosine in the weights by which images are drawn: facets are tilted, volumes have none."""


@dataclass
class ImageChain:
    """The mirrors that a camera subpath has met behind the facet (a Dr.Jit PyTree).

    ``image`` is the combination of them and ``open`` whether it may become an image connection;
    ``reflectance`` is their product, ``depth`` the optical depth per channel so far and ``d_vcm``
    that of the facet, 1 / density of the sampled direction.
    """

    image: mi.UInt32
    open: mi.Bool
    reflectance: mi.Float
    depth: mi.Spectrum
    d_vcm: mi.Float

    @staticmethod
    def closed() -> ImageChain:
        """Return the chain of a subpath that has not met the facet."""
        return ImageChain(mi.UInt32(0), mi.Bool(False), mi.Float(1), mi.Spectrum(0), mi.Float(0))


def mirror_faces(scene: Scene) -> NDArray[np.bool_]:
    """Return which of `FACES` are mirrors, ``(5,)``: smooth boundaries to the air."""
    return np.array(
        [finish.roughness == 0.0 and scene.pad.index != 1.0 for finish in scene.finishes]
    )


class BoxImages:
    """The mirrors of one flat pad: those of its faces that are smooth."""

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
        dr.make_opaque(self.places, self.index, self.mirrors)

    def _digits(self, image: mi.UInt32) -> tuple[mi.UInt32, mi.UInt32, mi.UInt32]:
        """Return which mirror of x, y and z an image takes, 0 for none."""
        return image % 3, (image // 3) % 3, image // 9

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

    def reflectance(self, cosine: mi.Float) -> mi.Float:
        """Return Fresnel's reflectance inside the pad; ``cosine`` is that of incidence."""
        return mi.fresnel(-dr.abs(cosine), self.index)[0]

    def _weight(self, image: mi.UInt32, a: Vertex, y: Vertex) -> mi.Float:
        """Return what ``y`` may send to ``a`` by an image, without visibility; 0 without one."""
        span = self.point(image, y.p) - a.p
        squared = dr.maximum(dr.squared_norm(span), 1e-6)
        direction = span * dr.rsqrt(squared)
        sent = -self.folded(image, direction)
        weight = dr.maximum(dr.dot(a.n, direction), COSINE_MIN) / squared
        facing = dr.maximum(dr.dot(y.n, sent), COSINE_MIN)
        weight *= dr.select(y.volume, 1.0, facing)
        for axis, digit in enumerate(self._digits(image)):
            weight *= dr.select(digit > 0, self.reflectance(direction[axis]), 1.0)
            if self.mirrors is not None:
                weight *= dr.gather(mi.Float, self.mirrors, 3 * axis + digit)
        return weight

    @dr.syntax
    def draw(self, a: Vertex, y: Vertex, number: mi.Float) -> tuple[mi.UInt32, mi.Float]:
        """Return an image of ``y`` for ``a`` and its probability, for a uniform ``number``."""
        image, drawn = mi.UInt32(1), mi.UInt32(0)
        total, weight = mi.Float(0.0), mi.Float(0.0)
        number = mi.Float(number)
        while image < IMAGES:
            here = self._weight(image, a, y)
            total += here
            chance = dr.select(total > 0, here / total, 0.0)
            chosen = number < chance
            number = dr.select(chosen, number / chance, (number - chance) / (1.0 - chance))
            drawn = dr.select(chosen, image, drawn)
            weight = dr.select(chosen, here, weight)
            image += 1
        return drawn, dr.select(drawn > 0, weight / total, 0.0)

    @dr.syntax
    def probability(self, image: mi.UInt32, a: Vertex, y: Vertex) -> mi.Float:
        """Return the probability with which ``draw`` finds ``image``."""
        other, total = mi.UInt32(1), mi.Float(0.0)
        while other < IMAGES:
            total += self._weight(other, a, y)
            other += 1
        return self._weight(image, a, y) / total

    def _mirror(self, v: Vertex) -> mi.UInt32:
        """Return the image over the one mirror that ``v`` lies in, 0 if in none."""
        found = mi.UInt32(0)
        for axis in range(3):
            flat = dr.abs(v.n[axis]) > 1.0 - ON_FACE
            for digit in (1, 2) if axis < 2 else (1,):
                place = dr.gather(mi.Float, self.places, mi.UInt32(3 * axis + digit))
                there = flat & (dr.abs(v.p[axis] - place) < ON_FACE)
                found = dr.select(there & v.delta, digit * 3**axis, found)
        return found

    def _without(self, image: mi.UInt32, mirror: mi.UInt32) -> mi.UInt32:
        """Return ``image`` without a mirror that it takes; more than it where it does not."""
        kept = [
            dr.select(other == 0, digit, dr.select(digit == other, 0, IMAGES))
            for digit, other in zip(self._digits(image), self._digits(mirror), strict=True)
        ]
        return kept[0] + 3 * kept[1] + 9 * kept[2]

    @dr.syntax
    def connect(
        self, scene: mi.Scene, y: Vertex, a: Vertex, number: mi.Float, active: mi.Bool,
        guiding: GuidingDistribution,
    ) -> mi.Spectrum:  # fmt: skip
        """Return the MIS-weighted light that facet ``a`` gets from ``y`` over one image.

        A connection (``render.paths.connect.connect_vertices``) through boundaries that pass their
        reflectance, for light and for the choices of camera subpaths alike. Light subpaths do not
        sample facets of the camera, so no strategy behind ``a`` competes.
        """
        active = active & (y.weight > 0) & (a.weight > 0)
        image, probability = self.draw(a, y, number)
        span = self.point(image, y.p) - a.p
        squared = dr.maximum(dr.squared_norm(span), 1e-12)
        direction = span * dr.rsqrt(squared)
        w = -self.folded(image, direction)
        f_a, p_a, _ = evaluate_scattering(a, direction, mi.TransportMode.Radiance, active)
        p_a = dr.select(guiding.applies(a), guiding.mixture_pdf(a, direction, p_a), p_a)
        f_y, _, r_y = evaluate_scattering(y, w, mi.TransportMode.Importance, active)
        active = active & (probability > 0) & (dr.max(f_a) > 0) & (dr.max(f_y) > 0)
        # --------------------- Along the folded line, mirror by mirror ----------------
        here, d = a, mi.Vector3f(direction)
        left, reflectance, depth = mi.UInt32(image), mi.Float(1.0), mi.Spectrum(0.0)
        going = mi.Bool(active)
        while going:
            b, further, hit = trace_to_surface(scene, here, d, going)
            mirror = self._mirror(b)
            rest = self._without(left, mirror)
            meets = going & hit & (mirror > 0) & (rest < IMAGES)
            active = active & (~going | meets)
            reflectance *= dr.select(meets, self.reflectance(dr.dot(b.n, d)), 1.0)
            depth += dr.select(meets, further, 0.0)
            d = dr.select(meets, self.folded(mirror, d), d)
            left = dr.select(meets, rest, left)
            here = dr.select(meets, b, here)
            going = meets & (left > 0)
        last_depth, clear = optical_depth(scene, y, here, active)
        transmittance = dr.exp(-depth - last_depth)
        # --------------------- Balance heuristic --------------------------------------
        arrival_y = arrival_density(y, transmittance, active)
        camera_y = p_a * reflectance * area_factor(y, w) * arrival_y / squared
        r_y = dr.select(y.terminal, 0.0, r_y)
        strategies = probability + camera_y * (y.d_vcm + y.d_vc * r_y)
        value = y.beta * f_y * f_a * a.beta * transmittance * reflectance / squared
        value *= y.weight * a.weight / strategies
        return dr.select(active & clear, value, 0.0)

    def arrive(
        self, chain: ImageChain, v: Vertex, state: SubpathState, facet: Vertex, wide: mi.Bool
    ) -> tuple[ImageChain, mi.Float]:
        """Follow a camera subpath to vertex ``v``; return the chain and ``d_vcm`` of ``v``.

        The latter is the ratio of image connections to the facet over what the camera subpath
        does, where there are any: 0 otherwise. ``wide`` says that light subpaths connect ``v``.
        """
        probability = self.probability(chain.image, facet, v)
        squared = dr.squared_norm(self.point(chain.image, v.p) - facet.p)
        through = dr.mean(dr.exp(-chain.depth - state.depth))
        density = area_factor(v, state.d) * chain.reflectance * through
        d_vcm = chain.d_vcm * probability * squared / density
        d_vcm = dr.select(chain.open & wide & (chain.image > 0), d_vcm, 0.0)
        mirror = self._mirror(v)
        fits = chain.open & (mirror > 0) & ~self._taken(chain.image, mirror)
        following = ImageChain(
            chain.image + mirror, fits,
            chain.reflectance * self.reflectance(dr.dot(v.n, state.d)),
            chain.depth + state.depth, chain.d_vcm,
        )  # fmt: skip
        return following, d_vcm

    def _taken(self, image: mi.UInt32, mirror: mi.UInt32) -> mi.Bool:
        """Return whether ``image`` has a mirror on an axis of ``mirror`` already."""
        taken = mi.Bool(False)
        for one, other in zip(self._digits(image), self._digits(mirror), strict=True):
            taken |= (one > 0) & (other > 0)
        return taken
