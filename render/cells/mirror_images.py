"""Connections over the smooth faces of a pad, by the image method.

Where faces of a pad are smooth or metal, light from a vertex ``y`` reaches the coating over the
lower face, over a wall, or over several of them, on the straight line to an image of ``y``. No
random direction finds an image of a volume, or of a lobe on a rough face, often enough; this
connects to one of them, drawn in proportion to what it may send. Ways that have no image are left
to camera subpaths, which reflect by chance and compete in the balance heuristic for the others as
well.

What the mirrors are is said by ``BoxImages`` for a flat pad and by ``BentImages`` for a bent one.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from render.paths.connect import density_at, optical_depth, strategies_before, trace_to_surface
from render.paths.vertex import Vertex, evaluate_scattering
from render.paths.walk import GuidingDistribution, SubpathState, guided_pdf
from render.sampling.streams import Numbers
from render.scene import Scene

ON_FACE = 1e-3
"""Distance (mm), and cosine's distance from 1, by which a vertex on a face may miss its plane."""
COSINE_MIN = 0.1
"""Least cosine in the weights by which images are drawn: facets are tilted, volumes have none."""


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


def mirror_faces(scene: Scene) -> NDArray[np.bool_]:
    """Return which of `FACES` are mirrors, ``(5,)``: smooth boundaries to the air, and metal."""
    boundary = scene.pad.index != 1.0
    return np.array(
        [(boundary and finish.smooth) or finish.metal is not None for finish in scene.finishes]
    )


def metal_faces(scene: Scene) -> NDArray[np.float64]:
    """Return what the metal on `FACES` reflects, ``(5,)``; -1 where there is none."""
    metals = [finish.metal for finish in scene.finishes]
    return np.array([-1.0 if metal is None else metal for metal in metals])


class MirrorImages(ABC):
    """The mirrors of one pad: those of its faces that are smooth or metal.

    An image takes of each axis one of ``sizes`` mirrors or none (0); their order along the way does
    not matter, as those of different axes are at right angles. Image 0 takes none.
    """

    sizes: tuple[int, ...]
    repeated: int = 0
    """Events of numbers that `draw` takes for images over mirrors that face each other."""
    index: mi.Float
    metal: mi.Float | None
    """What the metal of each plane reflects, by its number; -1 without. None: there is no metal."""

    @property
    def count(self) -> int:
        """Combinations of mirrors."""
        return int(np.prod(self.sizes))

    @abstractmethod
    def point(self, image: mi.UInt32, p: mi.Point3f) -> mi.Point3f:
        """Return the image of ``p``."""

    @abstractmethod
    def folded(self, image: mi.UInt32, direction: mi.Vector3f) -> mi.Vector3f:
        """Return ``direction`` after all mirrors of ``image``."""

    def line(self, image: mi.UInt32, a: mi.Point3f, p: mi.Point3f) -> tuple[mi.Vector3f, mi.Float]:
        """Return the direction from ``a`` to the image of ``p``, and what light spreads to there.

        That is the area across the way per solid angle at ``a`` (mm^2 / sr).
        """
        span = self.point(image, p) - a
        squared = dr.maximum(dr.squared_norm(span), 1e-12)
        return span * dr.rsqrt(squared), squared

    @abstractmethod
    def draw(
        self, a: Vertex, y: Vertex, number: mi.Float, candidates: Sequence[Numbers] = ()
    ) -> tuple[mi.UInt32, mi.Float]:
        """Return an image of ``y`` for ``a`` and its probability, for a uniform ``number``.

        ``candidates`` are the numbers of `repeated` events.
        """

    @abstractmethod
    def probability(self, image: mi.UInt32, a: Vertex, y: Vertex) -> mi.Float:
        """Return the probability with which ``draw`` finds ``image``."""

    @abstractmethod
    def _mirror(self, v: Vertex) -> mi.UInt32:
        """Return the image over the one mirror that ``v`` lies in, 0 if in none."""

    @abstractmethod
    def _plane(self, mirror: mi.UInt32) -> mi.UInt32:
        """Return the number of the plane that an image over one mirror takes."""

    def follow(self, b: Vertex, d: mi.Vector3f, left: mi.UInt32, going: mi.Bool) -> FoldedLine:
        """Follow a line along ``d`` at ``b``, before which the mirrors of ``left`` lie."""
        mirror = self._mirror(b)
        rest = self._without(left, mirror)
        meets = going & (mirror > 0) & (rest < self.count)
        reflected, chosen = self.met_at(self._plane(mirror), dr.dot(b.n, d))
        return FoldedLine(
            meets, meets & (rest > 0), rest, self.folded(mirror, d), reflected, chosen
        )

    def extend(self, chain: ImageChain, v: Vertex, d: mi.Vector3f) -> ImageChain:
        """Return ``chain`` with the mirror at ``v``, at which a camera subpath arrived by ``d``."""
        mirror = self._mirror(v)
        fits = chain.open & (mirror > 0) & ~self._taken(chain.image, mirror)
        _, chosen = self.met_at(self._plane(mirror), dr.dot(v.n, d))
        chance = chain.chance * chosen
        return ImageChain(chain.image + mirror, fits, chance, chain.depth, chain.d_vcm)

    def reflectance(self, plane: mi.UInt32, cosine: mi.Float) -> mi.Float:
        """Return what a plane reflects in the pad; ``cosine`` is that of incidence."""
        reflected = mi.fresnel(-dr.abs(cosine), self.index)[0]
        if self.metal is None:
            return reflected
        metal = dr.gather(mi.Float, self.metal, plane)
        return dr.select(metal < 0, reflected, metal)

    def met_at(self, plane: mi.UInt32, cosine: mi.Float) -> tuple[mi.Float, mi.Float]:
        """Return what a mirror reflects, and the chance that a path is reflected.

        It is reflected by chance where it could leave the pad, and always by metal.
        """
        reflected = self.reflectance(plane, cosine)
        if self.metal is None:
            return reflected, reflected
        metal = dr.gather(mi.Float, self.metal, plane) >= 0
        return reflected, dr.select(metal, 1.0, reflected)

    def _digits(self, image: mi.UInt32) -> list[mi.UInt32]:
        """Return which mirror of each axis an image takes, 0 for none."""
        digits = []
        for size in self.sizes[:-1]:
            digits.append(image % size)
            image = image // size
        return [*digits, image]

    def _combined(self, digits: list[mi.UInt32]) -> mi.UInt32:
        """Return the image that takes these mirrors."""
        image, radix = mi.UInt32(0), 1
        for digit, size in zip(digits, self.sizes, strict=True):
            image += radix * digit
            radix *= size
        return image

    def _without(self, image: mi.UInt32, mirror: mi.UInt32) -> mi.UInt32:
        """Return ``image`` without a mirror that it takes; `count` or more where it does not."""
        kept = [
            dr.select(other == 0, digit, dr.select(digit == other, 0, self.count))
            for digit, other in zip(self._digits(image), self._digits(mirror), strict=True)
        ]
        return self._combined(kept)

    def _taken(self, image: mi.UInt32, mirror: mi.UInt32) -> mi.Bool:
        """Return whether ``image`` has a mirror on an axis of ``mirror`` already."""
        taken = mi.Bool(False)
        for one, other in zip(self._digits(image), self._digits(mirror), strict=True):
            taken |= (one > 0) & (other > 0)
        return taken

    @dr.syntax
    def connect(
        self, scene: mi.Scene, y: Vertex, a: Vertex, number: mi.Float, active: mi.Bool,
        guiding: GuidingDistribution, returning: GuidingDistribution | None = None,
        candidates: Sequence[Numbers] = (),
    ) -> mi.Spectrum:  # fmt: skip
        """Return the MIS-weighted light that facet ``a`` gets from ``y`` over one image.

        A connection (``render.paths.connect.connect_vertices``) through boundaries that pass their
        reflectance, and camera subpaths by the chance of being reflected. Light subpaths do not
        sample facets of the camera, so no strategy behind ``a`` competes.
        """
        active = active & (y.weight > 0) & (a.weight > 0)
        image, probability = self.draw(a, y, number, candidates)
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
