"""Lamps cast into a flat pad, joined to facets over walls that face each other, over and over.

``LampAim`` sends camera subpaths over each wall once. Between facing mirrors light goes on to and
fro, and where the index is above the root of two a direction may be reflected totally by all faces:
a lamp is then seen many times, each time smaller. Subpaths meet those images by chance, too rarely
for their error bars to know. Unfolded over the walls (image method) each is one straight line, so
facets are joined to a point on the image of the lamp's end (next event estimation), and the balance
heuristic (Veach 1997, sec. 9.2) compares that with the subpaths that meet it.

Images are numbered by the cell of the unfolded pad that they lie in, as in
``render.cells.lamp_ways``. Those that ``LampAim`` knows are left to it.
"""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from render.cells.fiber_light import FiberLight, LampRay
from render.cells.lamp_ways import box_image, wall_reflections
from render.cells.mirror_images import mirror_faces
from render.cells.repeated_images import RepeatedImages
from render.geometry import LOWER
from render.paths.connect import optical_depth, trace_to_surface
from render.paths.vertex import Vertex, channel_mean, empty_vertex, evaluate_scattering
from render.paths.walk import GuidingDistribution, guided_pdf
from render.sampling.streams import Numbers
from render.scene import FACES, Scene

CELL_MAX = 40
"""Cells beyond it, in either direction, are left to camera subpaths that meet the lamp."""
CELLS = 2 * CELL_MAX + 1
DEPTHS = 8
"""Cells in z, 0 to -7: the lower face may reflect, and in turn with it the top of a rim."""
RIM_CELL_MAX = 5
"""Cells in x and y where the top of a rim has reflected."""
RIM_SHARE = 0.05
"""What of the coating sees those, about: the top of a rim is narrow."""
CODES = DEPTHS * CELLS**2
AIMED_CELL_MAX = 1
"""Cells up to here are known to ``LampAim``."""
LEAST_SHARE = 1e-7
"""Part of the light of a lamp's images below which one is left to camera subpaths."""
SLOTS = 1 << 16
"""Slots of equal probability by which images are drawn."""
GRID = 3
"""Points of the coating along x and y at which shares of images are estimated."""
COSINE_MIN = 0.05
"""Least cosine at the coating in shares: facets are tilted."""
ROW = 12
"""Numbers of an image: sign and shift (3 each), and how often each side reflects (6)."""


class LampImages:
    """The images of all lamps in a flat pad beyond the nearest, and how likely each is drawn."""

    def __init__(self, scene: Scene, light: FiberLight) -> None:
        """List the images and weigh them on a grid of points of the coating."""
        # These have the top of a rim as well.
        self.light, self.mirrors = light, RepeatedImages(scene)
        low, high = scene.box.low, scene.box.high
        cells = _cells(scene)
        lamps = np.flatnonzero(_cast_in(scene))
        lamp_of = np.repeat(lamps, len(cells)).astype(np.uint32)
        code_of = np.tile([_code(cell) for cell in cells], len(lamps))
        rows = np.array(
            [[*np.concatenate(box_image(low, high, cell)), *wall_reflections(cell)]
             for cell in cells]
        )  # fmt: skip
        self._rows = mi.Float(np.tile(rows, (len(lamps), 1)).astype(np.float32).ravel())
        self._low, self._size = mi.Vector3f(*low.tolist()), mi.Vector3f(*(high - low).tolist())
        self._none = mi.UInt32(len(lamp_of))
        dr.make_opaque(self._rows, self._low, self._size, self._none)
        share = self._shares(scene, lamp_of, cells)
        drawn = np.full((scene.lamp_count, SLOTS), len(lamp_of), dtype=np.uint32)
        chosen = np.zeros(len(lamp_of) + 1)
        table = np.full((scene.lamp_count, CODES + 1), len(lamp_of), dtype=np.uint32)
        for lamp in lamps:
            own = np.flatnonzero((lamp_of == lamp) & (share > LEAST_SHARE))
            if not len(own):
                continue
            # Each has one slot at least.
            count = 1 + np.floor((SLOTS - len(own)) * share[own]).astype(np.int64)
            count[count.argmax()] += SLOTS - count.sum()
            drawn[lamp] = np.repeat(own, count)
            chosen[own] = count / SLOTS
            table[lamp, code_of[own]] = own
        self._drawn, self._table = mi.UInt32(drawn.ravel()), mi.UInt32(table.ravel())
        self._chosen = mi.Float(chosen.astype(np.float32))
        dr.make_opaque(self._drawn, self._table, self._chosen)

    def _shares(
        self, scene: Scene, lamp_of: np.ndarray, cells: list[tuple[int, int, int]]
    ) -> np.ndarray:
        """Return what part of the light of its lamp's images each sends to the coating."""
        low, high = scene.box.low, scene.box.high
        step = (np.arange(GRID) + 0.5) / GRID
        x, y = np.meshgrid(low[0] + (high - low)[0] * step, low[1] + (high - low)[1] * step)
        points = GRID**2
        lane = dr.arange(mi.UInt32, len(lamp_of) * points)
        entry, at = lane // points, lane % points
        p = mi.Point3f(
            dr.gather(mi.Float, mi.Float(x.ravel()), at),
            dr.gather(mi.Float, mi.Float(y.ravel()), at),
            mi.Float(float(scene.pad.thickness)),
        )
        lamp = dr.gather(mi.UInt32, mi.UInt32(lamp_of), entry)
        # Each with a point of the lamp's end of its own (R3 sequence).
        u, v, w = (mi.Float(at) * each for each in (0.8191725, 0.6710436, 0.5497005))
        u, v, w = (each - dr.floor(each) for each in (u, v, w))
        direction, distance, ray = self.line(entry, lamp, p, u, mi.Point2f(v, w))
        level = mi.Float(0.0)
        for value in ray.radiance:
            level += value / len(ray.radiance)
        sent = level * self.reflected(entry, direction) / dr.square(distance)
        sent *= dr.maximum(-direction.z, COSINE_MIN)
        strength = np.array(sent, dtype=np.float64).reshape(len(lamp_of), points).mean(axis=1)
        strength[np.tile([z < -1 for _, _, z in cells], len(strength) // len(cells))] *= RIM_SHARE
        total = np.bincount(lamp_of, strength, minlength=scene.lamp_count)[lamp_of]
        return np.divide(strength, total, out=np.zeros(len(lamp_of)), where=total > 0)

    # -- which image ----------------------------------------------------------------------------

    def along(self, lamp: mi.UInt32, a: mi.Point3f, direction: mi.Vector3f) -> mi.UInt32:
        """Return the image of ``lamp`` that is met on the way from ``a`` by ``direction`` (mm).

        That is unfolded, and as long as the way is. `none` where there is no such image.
        """
        end = (a + direction - self._low) / self._size
        x, y, z = (dr.floor(end[i]) for i in range(3))
        known = (dr.abs(x) <= CELL_MAX) & (dr.abs(y) <= CELL_MAX) & (z <= 0) & (z > -DEPTHS)
        number = ((x + CELL_MAX) * CELLS + y + CELL_MAX) * DEPTHS - z
        code = dr.select(known, mi.UInt32(dr.maximum(number, 0.0)), CODES)
        return dr.gather(mi.UInt32, self._table, lamp * (CODES + 1) + code)

    def drawn(self, lamp: mi.UInt32, number: mi.Float) -> mi.UInt32:
        """Return an image of ``lamp`` for a uniform ``number``."""
        slot = dr.minimum(mi.UInt32(number * SLOTS), SLOTS - 1)
        return dr.gather(mi.UInt32, self._drawn, lamp * SLOTS + slot)

    def probability(self, entry: mi.UInt32) -> mi.Float:
        """Return the probability with which an image is `drawn`."""
        return dr.gather(mi.Float, self._chosen, entry)

    @property
    def none(self) -> mi.UInt32:
        """What stands for no image."""
        return self._none

    def _row(self, entry: mi.UInt32, first: int, count: int) -> list[mi.Float]:
        base = ROW * dr.minimum(entry, self._none - 1) + first
        return [dr.gather(mi.Float, self._rows, base + i) for i in range(count)]

    def reflected(
        self, entry: mi.UInt32, direction: mi.Vector3f, *, chance: bool = False
    ) -> mi.Float:
        """Return what all mirrors on the way reflect, or the chance to be reflected by them."""
        counts = self._row(entry, 6, 6)
        through = mi.Float(1.0)
        for side, count in enumerate(counts):
            plane = mi.UInt32(3 * (side // 2) + 1 + side % 2)
            both = self.mirrors.met_at(plane, direction[side // 2])
            once = both[1] if chance else both[0]
            through *= dr.select(count > 0, dr.power(once, count), 1.0)
        return through

    # -- lines ----------------------------------------------------------------------------------

    def line(
        self, entry: mi.UInt32, lamp: mi.UInt32, a: mi.Point3f, pick: mi.Float, square: mi.Point2f
    ) -> tuple[mi.Vector3f, mi.Float, LampRay]:
        """Return direction and length of the line from ``a`` to an image, and what it carries."""
        row = self._row(entry, 0, 6)
        sign, shift = mi.Vector3f(row[:3]), mi.Vector3f(row[3:])
        point = self.light.sample_position(lamp, pick, square)[0]
        # The image of ``a`` sees the lamp where it is.
        seen_from = sign * (mi.Vector3f(a) - shift)
        span = mi.Vector3f(point) - seen_from
        distance = dr.norm(span)
        folded = span / dr.maximum(distance, 1e-9)
        ray = self.light.ray(lamp, mi.Point3f(seen_from), -folded)
        return sign * folded, distance, ray

    def joined(
        self, scene: mi.Scene, lamp: mi.UInt32, a: Vertex, numbers: Numbers,
        guiding: GuidingDistribution,
    ) -> list[mi.Float]:  # fmt: skip
        """Return, per direction node, the light of one image joined to facets ``a``."""
        pick, node, x, y = numbers
        entry = self.drawn(lamp, pick)
        direction, distance, ray = self.line(entry, lamp, a.p, node, mi.Point2f(x, y))
        density = ray.joined * self.probability(entry)
        active = (a.weight > 0) & (density > 0)
        f, pdf, _ = evaluate_scattering(a, direction, mi.TransportMode.Radiance, active)
        pdf = guided_pdf(guiding, a, direction, pdf)
        active &= dr.max(f) > 0
        carried, transmittance = self._followed(scene, a, direction, distance, active)
        by_chance = pdf * self.reflected(entry, direction, chance=True)
        value = channel_mean(a.beta * f * transmittance) * carried * a.weight
        value /= density + by_chance
        return [dr.select(active & (each > 0), each * value, 0.0) for each in ray.radiance]

    def strategies(
        self, entry: mi.UInt32, lamp: mi.UInt32, a: Vertex, folded: mi.Vector3f,
        d_vcm: mi.Float,
    ) -> mi.Float:  # fmt: skip
        """Return the density of joining over that of a camera subpath that met an image of a lamp.

        The subpath left the facet ``a`` with a density of 1 / ``d_vcm`` and meets the lamp along
        ``folded``; 0 for `none`. Transmittances are in neither density, here and in `joined`.
        """
        row = self._row(entry, 0, 6)
        sign, shift = mi.Vector3f(row[:3]), mi.Vector3f(row[3:])
        seen_from = mi.Point3f(sign * (mi.Vector3f(a.p) - shift))
        ray = self.light.ray(lamp, seen_from, -folded)
        density = ray.joined * self.probability(entry)
        chance = self.reflected(entry, sign * folded, chance=True)
        return dr.select(density > 0, density * d_vcm / dr.maximum(chance, 1e-12), 0.0)

    @dr.syntax
    def _followed(
        self, scene: mi.Scene, a: Vertex, direction: mi.Vector3f, distance: mi.Float,
        active: mi.Bool,
    ) -> tuple[mi.Float, mi.Spectrum]:  # fmt: skip
        """Return what comes from so far away over the mirrors, and transmittances of media.

        The first is 0 where something is in the way.
        """
        here, d, left = a, mi.Vector3f(direction), mi.Float(distance)
        depth, reflectance = mi.Spectrum(0.0), mi.Float(1.0)
        clear, going = mi.Bool(active), mi.Bool(active)
        while going:
            b, further, hit = trace_to_surface(scene, here, d, going)
            step = dr.norm(b.p - here.p)
            there, reflected, _, turned = self.mirrors.met(b, d)
            arrives = hit & (step >= left)
            meets = going & hit & ~arrives & there
            clear = clear & (~going | meets | arrives)
            depth += dr.select(meets, further, 0.0)
            reflectance *= dr.select(meets, reflected, 1.0)
            left -= dr.select(meets, step, 0.0)
            d = dr.select(meets, turned, d)
            here = dr.select(meets, b, here)
            going = meets
        end = empty_vertex()
        # No surface to step off: like a vertex in a volume.
        end.p, end.volume = here.p + left * d, mi.Bool(True)
        last, seen = optical_depth(scene, here, end, clear)
        return dr.select(clear & seen, reflectance, 0.0), dr.exp(-depth - last)


def _cast_in(scene: Scene) -> np.ndarray:
    """Return which lamps are in the silicone of pad and rim, ``(lamp,)``."""
    return np.array([lamp.solid in ("pad", "diffuser") for lamp in scene.placed_lamps()])


def has_lamp_images(scene: Scene) -> bool:
    """Return whether a flat pad has lamps that its walls show over and over."""
    return bool(_cast_in(scene).any()) and bool(_cells(scene))


def _cells(scene: Scene) -> list[tuple[int, int, int]]:
    """Return the cells of all images that facets may see and no aim knows."""
    mirrors = dict(zip(FACES, mirror_faces(scene), strict=True))
    reach = [
        CELL_MAX if mirrors[low] and mirrors[high] else AIMED_CELL_MAX
        for low, high in (("left", "right"), ("base", "tip"))
    ]
    below = mirrors[FACES[LOWER]] and not scene.window_refracts
    # The top of a rim is a face of the pad beside the skin.
    strip = bool(scene.box.layered.any()) and scene.pad.roughness == 0.0
    levels = range(0, -DEPTHS if strip else -2, -1) if below else (0,)
    found = [
        (x, y, z)
        for x in range(-reach[0], reach[0] + 1)
        for y in range(-reach[1], reach[1] + 1)
        for z in levels
        if (z < -1 and max(abs(x), abs(y)) <= RIM_CELL_MAX)
        or (z >= -1 and max(abs(x), abs(y)) > AIMED_CELL_MAX)
    ]
    singles = {(0, False): "left", (0, True): "right", (1, False): "base", (1, True): "tip"}
    return [
        cell
        for cell in found
        if all(mirrors[singles[axis, cell[axis] > 0]] for axis in (0, 1) if abs(cell[axis]) == 1)
    ]


def _code(cell: Sequence[int]) -> int:
    """Return the number of a cell among CODES."""
    x, y, z = cell
    return ((x + CELL_MAX) * CELLS + y + CELL_MAX) * DEPTHS - z
