"""Lamps cast into a flat pad, joined to facets over walls that face each other, over and over.

``LampAim`` sends camera subpaths over each wall once. Between facing mirrors light goes on to and
fro, and where the index is above the root of two a direction may be reflected totally by all faces:
a lamp is then seen many times, each time smaller. Subpaths meet those images by chance, too rarely
for their error bars to know. Unfolded over the walls (image method) each is one straight line, so
facets are joined to a point on the image of the lamp's end (next event estimation), and the balance
heuristic (Veach 1997, sec. 9.2) compares that with the subpaths that meet it.

So are the diffuse vertices behind the facet, for light that goes from the skin over such walls to
the facet: connections to light subpaths know one wall of each pair. There light subpaths compete.

An image is the cell of the unfolded pad that it lies in (``render.cells.lamp_cells``), packed
into one number. Near ones are drawn from a table, by what they send, and far ones by a
formula (``render.cells.far_cells``). The nearest are left to ``LampAim`` at the facet, not at
vertices that come *later*.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from render.cells.far_cells import FarCells, has_far_cells
from render.cells.fiber_light import FiberLight, LampRay
from render.cells.lamp_cells import (
    CELL_MAX,
    CODES,
    DEPTHS,
    ORIGIN,
    RIM_SHARE,
    STEP,
    UP,
    aimed_cells,
    cast_in,
    code_of,
    far_levels,
    lamp_cells,
    met_until,
    over_a_rim,
    packed,
)
from render.cells.mirror_images import FoldedWay, MirrorImages
from render.cells.repeated_images import RepeatedImages
from render.paths.connect import area_factor, optical_depth, trace_to_surface
from render.paths.vertex import Vertex, channel_mean, empty_vertex, evaluate_scattering
from render.paths.walk import GuidingDistribution, guided_pdf
from render.sampling.streams import Numbers
from render.scene import Scene

NO_IMAGE = (1 << 32) - 1
"""What stands for no image."""
LEAST_SHARE = 1e-7
"""Part of the light of a lamp's images below which one is left to camera subpaths."""
SLOTS = 1 << 17
"""Slots of equal probability by which images are drawn."""
GRID = 3
"""Points of the coating along x and y at which shares of images are estimated."""
COSINE_MIN = 0.05
"""Least cosine at the coating in shares: facets are tilted."""
OUTER = 10
"""Last rings of the table, which tell what lies beyond it."""
BEYOND = np.log(8.0)
"""By how many factors of e in distance coatings see far images, about: pyramids are in the way."""


class LampImages:
    """The images of all lamps in a flat pad beyond the nearest, and how likely each is drawn."""

    def __init__(self, scene: Scene, light: FiberLight) -> None:
        """List the images and weigh them on a grid of points of the coating."""
        self.light, self.mirrors = light, self._mirrors(scene)
        self.lamps = scene.lamp_count
        low, high = scene.box.low, scene.box.high
        cells = lamp_cells(scene)
        lamps = np.flatnonzero(cast_in(scene)).tolist()
        self._low, self._size = mi.Vector3f(*low.tolist()), mi.Vector3f(*(high - low).tolist())
        dr.make_opaque(self._low, self._size)
        images, codes = packed(*cells.T).astype(np.uint32), code_of(*cells.T)
        self._far_cells: FarCells | None = None
        reaches_far = np.abs(cells[:, :2]).max(axis=0).min() == CELL_MAX
        if reaches_far and has_far_cells(scene):
            self._far_cells = FarCells(scene, CELL_MAX + 1, far_levels(scene, cells))
        # Those of facets, and of later vertices.
        drawn = np.full((2, self.lamps, SLOTS), NO_IMAGE, dtype=np.uint32)
        chosen = np.zeros((2, self.lamps, CODES + 1), dtype=np.float32)
        far = np.zeros((2, self.lamps), dtype=np.float32)
        aimed = aimed_cells(scene, cells)
        outer = np.abs(cells[:, :2]).max(axis=1) > CELL_MAX - OUTER
        for lamp in lamps:
            strength = self._strengths(scene, lamp, images, cells)
            for later in (0, 1):
                sent = np.where(aimed & (later == 0), 0.0, strength)
                share = sent / max(sent.sum(), 1e-300)
                own = np.flatnonzero(share > LEAST_SHARE)
                if not len(own):
                    continue
                # Each has one slot at least.
                count = 1 + np.floor((SLOTS - len(own)) * share[own]).astype(np.int64)
                count[count.argmax()] += SLOTS - count.sum()
                drawn[later, lamp] = np.repeat(images[own], count)
                if self._far_cells is not None:
                    # Each ring sends 1 / r of what the first would.
                    tail = share[outer].sum() * (CELL_MAX - OUTER / 2) / OUTER * BEYOND
                    far[later, lamp] = tail / (1.0 + tail)
                chosen[later, lamp, codes[own]] = (1.0 - far[later, lamp]) * count / SLOTS
        self._drawn, self._chosen = mi.UInt32(drawn.ravel()), mi.Float(chosen.ravel())
        self._far = mi.Float(far.ravel())
        dr.make_opaque(self._drawn, self._chosen, self._far)

    def _strengths(
        self, scene: Scene, lamp: int, images: np.ndarray, cells: np.ndarray
    ) -> np.ndarray:
        """Return what each near image of a lamp sends to the coating, about."""
        low, high = scene.box.low, scene.box.high
        step = (np.arange(GRID) + 0.5) / GRID
        x, y = np.meshgrid(low[0] + (high - low)[0] * step, low[1] + (high - low)[1] * step)
        points = GRID**2
        lane = dr.arange(mi.UInt32, len(images) * points)
        image, at = dr.gather(mi.UInt32, mi.UInt32(images), lane // points), lane % points
        p = mi.Point3f(
            dr.gather(mi.Float, mi.Float(x.ravel()), at),
            dr.gather(mi.Float, mi.Float(y.ravel()), at),
            mi.Float(float(scene.pad.thickness)),
        )
        # Each with a point of the lamp's end of its own (R3 sequence).
        u, v, w = (mi.Float(at) * each for each in (0.8191725, 0.6710436, 0.5497005))
        u, v, w = (each - dr.floor(each) for each in (u, v, w))
        direction, distance, ray = self.line(image, mi.UInt32(lamp), p, u, mi.Point2f(v, w))
        level = mi.Float(0.0)
        for value in ray.radiance:
            level += value / len(ray.radiance)
        sent = level * self.reflected(image, p, direction) / dr.square(distance)
        sent *= dr.maximum(-direction.z, COSINE_MIN)
        strength = np.array(sent, dtype=np.float64).reshape(len(images), points).mean(axis=1)
        strength[over_a_rim(scene, cells)] *= RIM_SHARE
        return strength

    def _mirrors(self, scene: Scene) -> MirrorImages:
        """Return the faces that reflect; these have the top of a rim as well."""
        return RepeatedImages(scene)

    # -- which image ----------------------------------------------------------------------------

    def along(
        self, lamp: mi.UInt32, later: mi.Bool, a: mi.Point3f, direction: mi.Vector3f,
        way: FoldedWay,
    ) -> mi.UInt32:  # fmt: skip
        """Return the image of ``lamp`` that is met on a ``way`` that left ``a`` in a direction.

        ``NO_IMAGE`` where there is none that is drawn.
        """
        each = way.across / dr.maximum(dr.hypot(direction.x, direction.y), 1e-9)
        x, y = (
            dr.floor((a[i] + each * direction[i] - self._low[i]) / self._size[i]) for i in (0, 1)
        )
        z = self._level(mi.Int32(way.levels), mi.Int32(way.bonds))
        z = dr.select(direction.z < 0, -z, z)
        known = (dr.abs(x) < ORIGIN) & (dr.abs(y) < ORIGIN) & (z <= UP) & (z > UP - DEPTHS)
        x, y, z = (dr.select(known, each, 0.0) for each in (x, y, z))
        image = mi.UInt32(packed(mi.Int32(x), mi.Int32(y), mi.Int32(z)))
        return dr.select(known & (self.probability(lamp, later, image) > 0), image, NO_IMAGE)

    def _level(self, levels: mi.Int32, bonds: mi.Int32) -> mi.Int32:
        """Return by how many cells of z a way is unfolded; one over a bond has no image here."""
        return dr.select(bonds == 0, levels, DEPTHS)

    def drawn(self, lamp: mi.UInt32, later: mi.Bool, numbers: Numbers) -> mi.UInt32:
        """Return an image of ``lamp`` for uniform ``numbers``."""
        number, distance, place, sign = numbers
        row = self._table(lamp, later)
        far = dr.gather(mi.Float, self._far, row)
        near = (number - far) / (1.0 - far)
        slot = dr.minimum(mi.UInt32(dr.maximum(near, 0.0) * SLOTS), SLOTS - 1)
        image = dr.gather(mi.UInt32, self._drawn, row * SLOTS + slot)
        if self._far_cells is None:
            return image
        x, y, z, there = self._far_cells.drawn(distance, place, sign)
        beyond = dr.select(there, mi.UInt32(packed(x, y, z)), NO_IMAGE)
        return dr.select(number < far, beyond, image)

    def probability(self, lamp: mi.UInt32, later: mi.Bool, image: mi.UInt32) -> mi.Float:
        """Return the probability with which an image of ``lamp`` is `drawn`."""
        row = self._table(lamp, later)
        x, y, z = self._cell(image)
        near = (dr.abs(x) <= CELL_MAX) & (dr.abs(y) <= CELL_MAX)
        code = dr.select(near, code_of(x, y, z), CODES)
        chosen = dr.gather(mi.Float, self._chosen, row * (CODES + 1) + mi.UInt32(code))
        if self._far_cells is None:
            return chosen
        far = dr.gather(mi.Float, self._far, row)
        return chosen + far * self._far_cells.probability(mi.Float(x), mi.Float(y), z)

    def _table(self, lamp: mi.UInt32, later: mi.Bool) -> mi.UInt32:
        """Return the row of a lamp in the tables of facets or of later vertices."""
        return lamp + dr.select(later, mi.UInt32(self.lamps), 0)

    def _cell(self, image: mi.UInt32) -> list[mi.Int32]:
        """Return x, y and z of an image; far away for ``NO_IMAGE``."""
        level = image // DEPTHS
        z = UP - mi.Int32(image % DEPTHS)
        return [mi.Int32(level // STEP) - ORIGIN, mi.Int32(level % STEP) - ORIGIN, z]

    def reflected(
        self, image: mi.UInt32, a: mi.Point3f, direction: mi.Vector3f, *, chance: bool = False
    ) -> mi.Float:
        """Return what all mirrors on the way reflect, or the chance to be reflected by them.

        The way leaves ``a`` along ``direction``.
        """
        through = mi.Float(1.0)
        for axis, cell in enumerate(self._cell(image)):
            for side, times in enumerate(met_until(cell)):
                through *= self._reflected_often(axis, side, times, direction[axis], chance)
        return through

    def _reflected_often(
        self, axis: int, side: int, times: mi.Int32, cosine: mi.Float, chance: bool,
        index: mi.Float | None = None,
    ) -> mi.Float:  # fmt: skip
        """Return what a face reflects so many ``times``, or the chance; in ``index`` (the pad)."""
        both = self.mirrors.met_at(mi.UInt32(3 * axis + 1 + side), cosine, index)
        once, count = both[1] if chance else both[0], mi.Float(times)
        return dr.select(count > 0, dr.power(once, count), 1.0)

    # -- lines ----------------------------------------------------------------------------------

    def _unfolding(self, image: mi.UInt32) -> tuple[mi.Vector3f, mi.Vector3f]:
        """Return sign and shift (mm) of images: that of p is sign * p + shift."""
        sign, shift = mi.Vector3f(1.0), mi.Vector3f(0.0)
        for axis, cell in enumerate(self._cell(image)):
            odd, moved = (cell & 1) != 0, mi.Float(cell) * self._size[axis]
            sign[axis] = dr.select(odd, -1.0, 1.0)
            shift[axis] = moved + dr.select(odd, 2.0 * self._low[axis] + self._size[axis], 0.0)
        return sign, shift

    def line(
        self, image: mi.UInt32, lamp: mi.UInt32, a: mi.Point3f, pick: mi.Float, square: mi.Point2f
    ) -> tuple[mi.Vector3f, mi.Float, LampRay]:
        """Return direction and length of the line from ``a`` to an image, and what it carries."""
        point = self.light.sample_position(lamp, pick, square)[0]
        direction, distance, folded = self._line_to(image, a, point)
        return direction, distance, self._ray(image, lamp, a, folded)

    def _line_to(
        self, image: mi.UInt32, a: mi.Point3f, point: mi.Point3f
    ) -> tuple[mi.Vector3f, mi.Float, mi.Vector3f]:
        """Return how the line to the image of a point begins, its length, and how it arrives."""
        sign, shift = self._unfolding(image)
        # The image of ``a`` sees the lamp where it is.
        span = mi.Vector3f(point) - sign * (mi.Vector3f(a) - shift)
        distance = dr.norm(span)
        folded = span / dr.maximum(distance, 1e-9)
        return sign * folded, distance, folded

    def _ray(
        self, image: mi.UInt32, lamp: mi.UInt32, a: mi.Point3f, folded: mi.Vector3f
    ) -> LampRay:
        """Return what the line from ``a`` carries that arrives at the lamp along ``folded``."""
        sign, shift = self._unfolding(image)
        return self.light.ray(lamp, mi.Point3f(sign * (mi.Vector3f(a) - shift)), -folded)

    def _left(self, image: mi.UInt32, folded: mi.Vector3f) -> mi.Vector3f:
        """Return how a line begins that arrives at the lamp along ``folded``."""
        return self._unfolding(image)[0] * folded

    def joined(
        self, scene: mi.Scene, lamp: mi.UInt32, later: mi.Bool, a: Vertex, which: Numbers,
        numbers: Numbers, guiding: GuidingDistribution,
    ) -> list[mi.Float]:  # fmt: skip
        """Return, per direction node, the light of one image joined to camera vertices ``a``.

        These are facets, or diffuse surfaces that come ``later``. ``which`` draws the image, and
        ``numbers`` a point of it.
        """
        node, x, y, _ = numbers
        image = self.drawn(lamp, later, which)
        direction, distance, ray = self.line(image, lamp, a.p, node, mi.Point2f(x, y))
        density = ray.joined * self.probability(lamp, later, image)
        active = (a.weight > 0) & ~a.volume & (density > 0)
        f, pdf, reverse = evaluate_scattering(a, direction, mi.TransportMode.Radiance, active)
        pdf = dr.select(a.terminal, 0.0, guided_pdf(guiding, a, direction, pdf))
        active &= dr.max(f) > 0
        carried, transmittance = self._followed(scene, image, a, direction, distance, active)
        # Light subpaths come the same way, and no strategy ends before a facet.
        by_light = ray.emitted * area_factor(a, direction) * (a.d_vcm + a.d_vc * reverse)
        by_chance = (pdf + by_light) * self.reflected(image, a.p, direction, chance=True)
        value = channel_mean(a.beta * f * transmittance) * carried * a.weight
        value /= density + by_chance
        return [dr.select(active & (each > 0), each * value, 0.0) for each in ray.radiance]

    def strategies(
        self, image: mi.UInt32, lamp: mi.UInt32, later: mi.Bool, a: mi.Point3f,
        folded: mi.Vector3f, d_vcm: mi.Float,
    ) -> mi.Float:  # fmt: skip
        """Return the density of joining over that of a camera subpath that met an image of a lamp.

        The subpath left a vertex at ``a`` with a density of 1 / ``d_vcm`` and meets the lamp along
        ``folded``; 0 for ``NO_IMAGE``. Transmittances are in neither density, here and in `joined`.
        """
        ray = self._ray(image, lamp, a, folded)
        density = ray.joined * self.probability(lamp, later, image)
        chance = self.reflected(image, a, self._left(image, folded), chance=True)
        return dr.select(density > 0, density * d_vcm / dr.maximum(chance, 1e-12), 0.0)

    @dr.syntax
    def _followed(
        self, scene: mi.Scene, image: mi.UInt32, a: Vertex, direction: mi.Vector3f,
        distance: mi.Float, active: mi.Bool,
    ) -> tuple[mi.Float, mi.Spectrum]:  # fmt: skip
        """Return what comes from so far away over the mirrors, and transmittances of media.

        The first is 0 where something is in the way.
        """
        here, d, left = a, mi.Vector3f(direction), mi.Float(distance)
        depth, reflectance, way = mi.Spectrum(0.0), mi.Float(1.0), FoldedWay.none()
        clear, going = mi.Bool(active), mi.Bool(active)
        while going:
            b, further, hit = trace_to_surface(scene, here, d, going)
            step = dr.norm(b.p - here.p)
            there, reflected, turned = self._met(image, way, b, d)
            arrives = hit & (step >= left)
            meets = going & hit & ~arrives & there
            clear = clear & (~going | meets | arrives)
            depth += dr.select(meets, further, 0.0)
            reflectance *= dr.select(meets, reflected, 1.0)
            left -= dr.select(meets, step, 0.0)
            way = way.through(b, turned, meets)
            d = dr.select(meets, turned, d)
            here = dr.select(meets, b, here)
            going = meets
        end = empty_vertex()
        # No surface to step off: like a vertex in a volume.
        end.p, end.volume = here.p + left * d, mi.Bool(True)
        last, seen = optical_depth(scene, here, end, clear)
        return dr.select(clear & seen, reflectance, 0.0), dr.exp(-depth - last)

    def _met(
        self, image: mi.UInt32, way: FoldedWay, v: Vertex, d: mi.Vector3f
    ) -> tuple[mi.Bool, mi.Float, mi.Vector3f]:
        """Return whether light on its way to an image goes on at ``v``, how much, and where to."""
        there, reflected, _, turned = self.mirrors.met(v, d)
        return there, reflected, turned
