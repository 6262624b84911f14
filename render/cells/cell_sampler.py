"""Transport cells and pictures of lit pads as path samplers (``render.sampling.proposals``).

One run fills ``T[fiber, node, target]``: primary numbers choose the site, the fiber, a pixel inside
the mask of each of the site's targets (its facets, or the untouched pad), and everything along the
paths. The same light paths serve all direction nodes of the fiber (``render.cells.fiber_light``)
and all facets of the site, so errors of facets of one site are correlated; those of sites are not.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from render.arrays import Array
from render.cells.arriving_light import ArrivingLight
from render.cells.facet_paths import FacetSubpath, radiance_per_node, trace_facet_subpath
from render.cells.fiber_light import FiberLight
from render.cells.guiding import (
    GUIDED_FRACTION,
    SEEN_GUIDED_FRACTION,
    Directions,
    FacetGuiding,
    FiberGlow,
)
from render.cells.lamp_aim import LampAim
from render.cells.lamp_connections import AimedSubpaths, Lamp
from render.cells.light_subpaths import CoatingTarget, DrawnVertices, trace_light_subpaths
from render.cells.lower_face_mirror import LowerFaceMirror
from render.cells.mirror_images import MirrorImages
from render.cells.sample_shares import SLOTS, near_slots
from render.geometry import (
    LOWER,
    camera_axes,
    camera_origin,
    counted_sites,
    facets,
    fiber_poses,
    flat_fiber_poses,
    half_view,
)
from render.optics.pad_scene import pad_scene
from render.pad import mirror_faces, plane_faces
from render.sampling.proposals import Splat
from render.sampling.streams import Stream
from render.scene import Scene

CELL_LIGHT_PATHS, PICTURE_LIGHT_PATHS = 4, 2
"""Light subpaths per sample of cells, and of a picture."""
CAMERA_STORED = 10
LIGHT_STORED = 10
CAMERA_STRIDE = 40
"""Events by which the camera subpaths of one lane are apart."""
CAMERA_EVENTS, CLEAR_CAMERA_EVENTS = 16, 19
"""Events that a camera subpath may take, on milky pads and on clear ones.

What the bound costs is measured in tests/validation.
"""
BONDED_CAMERA_EVENTS, BONDED_CAMERA_STRIDE = 30, 62
"""The same where a bond between pad and window refracts: light meets it on its way to and fro."""
MILKY_DEPTH = 6.0
"""Optical depth from which on a diffuser hides its lamps: e^-6 of their light comes through."""
CLEAR_ROUGHNESS = 0.05
"""Roughness below which the faces of a milky pad are too smooth for connections alone."""
NODES = 8
"""Direction nodes come in multiples of it: each number of them is a kernel of its own, which takes
seconds to compile, where eight nodes take at most a tenth longer to render than one."""
AIMED_MAX, AIMED_MIN = 0.8, 0.1
"""What of the guided directions goes to the lamp itself, on clear pads and on milky ones."""
LEARNED_MIN = 0.05
"""Least part of the guided directions that goes where photons came from; layers that leave less
of their lamps have none."""


def diffuser_depths(scene: Scene) -> Array:
    """Return the optical depth of diffuser before each lamp, straight through, ``(lamp,)``."""
    layer, milky = scene.diffuser, flat_fiber_poses(scene).milky
    return np.asarray((0.0 if layer is None else layer.sigma_s + layer.sigma_a) * milky)


def lamps_are_seen(scene: Scene) -> bool:
    """Return whether camera subpaths should look for the lamps themselves.

    Through a thick diffuser they would not find them, and light subpaths find everything that they
    could, as long as the faces are rough enough. Right either way: what is left out of the
    strategies is left out of their weights. Light straight from a lamp in the silicone has no
    vertex for light subpaths to be connected by.
    """
    if any(lamp.solid for lamp in scene.placed_lamps()):
        return True
    smoothest = min(finish.roughness for finish in scene.finishes if finish.paint is None)
    return bool(diffuser_depths(scene).min() < MILKY_DEPTH) or smoothest < CLEAR_ROUGHNESS


def has_further_images(scene: Scene) -> bool:
    """Return whether a layer sends much light to a flat pad over mirrors that face each other.

    No image is beyond them (``render.cells.mirror_images``). They are walls, or the lower face and
    the upper one of the layer, which has the finish of the pad. A thick layer hides what it sends
    back, but for metal: without it `rim` keeps 0.990 +- 0.012 of its light (a depth of 8), behind a
    depth of 0.4 `thin rim` 0.981 +- 0.004 (tests/validation/RESULTS.md).
    """
    layer = scene.diffuser
    if layer is None or layer.sigma_s == 0.0:
        return False
    left, tip, right, base, _ = mirror_faces(scene)
    walls = (left and right) or (base and tip)
    upper = scene.pad.roughness == 0.0 and scene.pad.index != 1.0
    thinnest = min(rim for rim in scene.box.rims if rim > 0.0)
    thin = (layer.sigma_s + layer.sigma_a) * thinnest < MILKY_DEPTH
    metal = any(finish.metal is not None for finish in scene.finishes)
    return bool((walls and metal) or (thin and (walls or upper)))


@dataclass(frozen=True)
class Targets:
    """What is looked at: each target owns ``pixel[offset[t]:offset[t + 1]]`` (int64 arrays)."""

    pixel: np.ndarray
    offset: np.ndarray

    @property
    def count(self) -> int:
        """Number of targets."""
        return len(self.offset) - 1


class TargetPixels:
    """The pixels of all targets on the camera's film, as Dr.Jit arrays."""

    def __init__(self, scene: Scene, targets: Targets) -> None:
        """Upload ``targets``."""
        self.columns = dr.opaque(mi.UInt32, scene.camera.columns)
        # One more entry: a target without pixels at the end reads past the others'.
        self._pixel = mi.UInt32(np.append(targets.pixel, 0).astype(np.uint32))
        self._offset = mi.UInt32(targets.offset.astype(np.uint32))
        dr.make_opaque(self._pixel, self._offset)

    def place(
        self, target: mi.UInt32, number: mi.Float, x: mi.Float, y: mi.Float
    ) -> tuple[mi.Float, mi.Float]:
        """Return column and row of a place in a target, for three uniform numbers."""
        begin = dr.gather(mi.UInt32, self._offset, target)
        size = dr.gather(mi.UInt32, self._offset, target + 1) - begin
        within = dr.minimum(mi.UInt32(number * mi.Float(size)), dr.maximum(size, 1) - 1)
        pixel = dr.gather(mi.UInt32, self._pixel, begin + within)
        row = pixel // self.columns
        return mi.Float(pixel - row * self.columns) + x, mi.Float(row) + y


def pixel_rays(
    scene: Scene, column: mi.Float, row: mi.Float, columns: int, rows: int
) -> tuple[mi.Point3f, mi.Vector3f]:
    """Return origins (mm) and unit directions through continuous image positions in pixels.

    The same lens as that of ``render.geometry.camera_rays``, as Dr.Jit arrays. Its numbers are
    data: compiled into the kernels, every camera would have its own.
    """
    half_width, half_height = (dr.opaque(mi.Float, n) for n in half_view(scene, columns, rows))
    right, down, ahead = (mi.Vector3f(*axis.tolist()) for axis in camera_axes(scene))
    origin = mi.Point3f(*camera_origin(scene).tolist())
    per_column, per_row = mi.Float(2.0 / columns), mi.Float(2.0 / rows)
    dr.make_opaque(right, down, ahead, origin, per_column, per_row)
    x = half_width * (per_column * column - 1)
    y = half_height * (per_row * row - 1)
    if scene.camera.fisheye:
        angle = dr.maximum(dr.hypot(x, y), 1e-9)
        sine, cosine = dr.sincos(angle)
        d = dr.normalize(sine / angle * (x * right + y * down) + cosine * ahead)
    else:
        d = dr.normalize(x * right + y * down + ahead)
    return origin + dr.zeros(mi.Point3f, dr.width(d)), d


class PadSampler:
    """What cells and pictures share: one pad (a bend, indented or untouched), lit by its fibers."""

    def __init__(self, scene: Scene, phi: Array, bend: float, indented: bool) -> None:
        """Load the pad; ``phi`` is ``(fiber, node)`` rad, ``bend`` rad."""
        self.scene = scene
        self.pad = pad_scene(scene, bend, indented)
        self.light = FiberLight(scene, phi, bend)
        self.mirror = LowerFaceMirror(scene, bend)
        self.target = CoatingTarget(scene, bend, self.mirror)
        mirrors = mirror_faces(scene)
        bonded = scene.window_refracts
        # Neither glossy vertices nor volumes are found by chance over a mirror.
        self.images: MirrorImages | None = None
        if mirrors.any() and not bonded:
            self.images = MirrorImages(plane_faces(scene, bend, indented), scene.pad.index)
        # No lobe about a mirror image passes a bond that refracts, or is as narrow as a mirror.
        self.glossy = None if bonded or mirrors[LOWER] else self.mirror
        # Over images that are not known camera subpaths find vertices in volumes.
        layer = scene.diffuser
        unknown = bonded or (mirrors.any() and bend != 0.0) or has_further_images(scene)
        self.passable = bool(unknown and layer is not None and layer.sigma_s > 0.0)
        self.lobed = scene.coating.lobe is not None
        self.seen = lamps_are_seen(scene)
        self.aim, self.ways, shares = self._ways(scene, bend, mirrors)
        self.shares = [dr.opaque(mi.Float, share) for share in shares]
        self.guided = SEEN_GUIDED_FRACTION if self.seen else GUIDED_FRACTION
        self.events = CLEAR_CAMERA_EVENTS if self.seen else CAMERA_EVENTS
        self.stride = CAMERA_STRIDE
        if bonded:
            self.events, self.stride = BONDED_CAMERA_EVENTS, BONDED_CAMERA_STRIDE

    def _ways(
        self, scene: Scene, bend: float, mirrors: np.ndarray
    ) -> tuple[LampAim | None, list[Directions], list[float]]:
        """Return how directions to the lamps are drawn, and the part of each: aims come first."""
        glow = FiberGlow(scene, bend)
        if not self.seen:
            return None, [glow], [1.0]
        clear = math.exp(-diffuser_depths(scene).min())
        # Light from within the pad is straight but for what the lower face reflects.
        passed = [LOWER if lamp.solid else lamp.face for lamp in scene.placed_lamps()]
        if mirrors[passed].any() and not self.mirror.curved and not scene.window_refracts:
            aim, part = LampAim(scene, self.mirror), max(AIMED_MIN, AIMED_MAX * clear)
            return aim, [aim, glow], [part, 1.0 - part]
        if clear < LEARNED_MIN:
            return None, [glow], [1.0]
        learned = AIMED_MAX * clear
        arriving = ArrivingLight(self.pad, self.light, scene.lamp_count)
        return None, [arriving, glow], [learned, 1.0 - learned]

    def guiding(self, fiber: mi.UInt32) -> FacetGuiding:
        """Return where the coating sends camera subpaths to find ``fiber``."""
        return FacetGuiding(self.ways, self.shares, self.guided, fiber)

    def lamp(self, fiber: mi.UInt32) -> Lamp | None:
        """Return the lamps of ``fiber`` where camera subpaths look for them."""
        if not self.seen:
            return None
        return Lamp(self.light, fiber, self.scene.pad.index == 1.0)

    def aimed(self, guiding: FacetGuiding, lamp: Lamp | None) -> AimedSubpaths | None:
        """Return the subpaths that find lamps behind smooth faces."""
        if lamp is None or self.aim is None:
            return None
        return AimedSubpaths(lamp, self.aim, guiding)

    def camera_subpath(
        self, column: mi.Float, row: mi.Float, size: tuple[int, int], stream: Stream,
        first: mi.UInt32, fiber: mi.UInt32,
    ) -> FacetSubpath:  # fmt: skip
        """Trace camera subpaths through positions on a film of ``size`` (columns, rows)."""
        o, d = pixel_rays(self.scene, column, row, *size)
        guiding, lamp = self.guiding(fiber), self.lamp(fiber)
        return trace_facet_subpath(
            self.pad, o, d, stream, first, guiding, self.glossy, self.images, lamp,
            self.aimed(guiding, lamp), self.events, self.passable,
        )  # fmt: skip

    def radiance(
        self, vertices: DrawnVertices, lane: mi.UInt32, subpath: FacetSubpath, stream: Stream,
        offset: mi.UInt32, fiber: mi.UInt32,
    ) -> list[mi.Float]:  # fmt: skip
        """Return, per direction node, what a camera subpath finds; `radiance_per_node` says how."""
        guiding, lamp = self.guiding(fiber), self.lamp(fiber)
        return radiance_per_node(
            self.pad, vertices, lane, subpath, stream, offset, guiding, self.glossy, self.images,
            lamp, self.aimed(guiding, lamp), self.lobed,
        )  # fmt: skip

    def light_vertices(
        self, point: mi.Point3f, normal: mi.Vector3f, fiber: mi.UInt32, stream: Stream, paths: int
    ) -> DrawnVertices:
        """Trace light subpaths; one vertex of each is drawn for ``point`` of the coating."""
        return trace_light_subpaths(
            self.pad,
            self.target,
            point,
            normal,
            self.light,
            fiber,
            stream,
            paths,
            self.guiding(fiber) if self.seen else None,
            self.passable,
            self.lobed,
        )


class CellSampler(PadSampler):
    """All cells of one pad: fiber and facet are extra primary dimensions."""

    stored = (CAMERA_STORED, CELL_LIGHT_PATHS, LIGHT_STORED)

    def __init__(
        self,
        scene: Scene,
        phi: Array,
        bend: float,
        indented: bool,
        targets: Targets,
        slots: np.ndarray | None = None,
        lit: np.ndarray | None = None,
    ) -> None:
        """Load the pad and upload targets; ``phi`` is ``(fiber, node)`` rad, ``bend`` rad.

        ``slots`` ``(site, fiber)`` are the samples' shares (`render.cells.sample_shares`), a
        multiple of `SLOTS` in all; by default those that favor near fibers. ``lit`` ``(site,
        fiber)`` may leave out fibers there, whose cells stay 0, and then all sites are targets,
        also those that do not count for the score.
        """
        self.fibers, self.channels = phi.shape
        node = filled_up(scene, self.channels)
        super().__init__(scene, phi[:, node], bend, indented)
        self._kept = np.searchsorted(node, np.arange(self.channels))
        self.targets = targets
        counted = counted_sites(scene) if lit is None else np.arange(scene.sites.count)
        self.sites = len(counted)
        self.faces = targets.count // self.sites
        self.bins = self.fibers * targets.count
        place = facets(scene, bend)
        site_position = place.site_position[counted]
        point = place.centroid[counted].mean(axis=1) if indented else site_position
        self._point = _points(point)
        self._normal = mi.Vector3f(_points(place.site_normal[counted]))
        if slots is None:
            slots = near_slots(site_position, fiber_poses(scene, bend).position, lit)
        number, total = np.arange(slots.size), int(slots.sum())
        each = np.repeat(number, slots.ravel())
        self._site = mi.UInt32((each // self.fibers).astype(np.uint32))
        self._fiber = mi.UInt32((each % self.fibers).astype(np.uint32))
        self._rows = mi.UInt32(total // SLOTS)
        self._faces = mi.UInt32(self.faces)
        # 1 / probability of a site and a fiber.
        self._scale = mi.Float((total / slots.ravel()[each]).astype(np.float32))
        self.pixels = TargetPixels(scene, targets)
        dr.make_opaque(self._point, self._normal, self._site, self._fiber, self._scale)
        dr.make_opaque(self._rows, self._faces)

    def evaluate(self, camera: Stream, light: Stream) -> list[Splat]:
        """Return a splat per facet of the chosen site: radiance per direction node."""
        pick_row, pick_slot, _, _ = camera.event(mi.UInt32(0))
        row = dr.minimum(mi.UInt32(pick_row * mi.Float(self._rows)), self._rows - 1)
        slot = row * SLOTS + dr.minimum(mi.UInt32(pick_slot * SLOTS), SLOTS - 1)
        site = dr.gather(mi.UInt32, self._site, slot)
        fiber = dr.gather(mi.UInt32, self._fiber, slot)
        vertices = self.light_vertices(
            dr.gather(mi.Point3f, self._point, site), dr.gather(mi.Vector3f, self._normal, site),
            fiber, light, CELL_LIGHT_PATHS,
        )  # fmt: skip
        # From here on one lane per facet: all facets of a site share its light subpaths.
        width = dr.width(site)
        lanes = dr.opaque(mi.UInt32, width)
        wide = dr.arange(mi.UInt32, width * self.faces)
        face = wide // lanes
        lane = wide - face * lanes
        values = self._radiance(
            dr.gather(mi.UInt32, site, lane) * self._faces + face,
            dr.gather(mi.UInt32, fiber, lane), vertices, lane, face, camera.of_lanes(lane),
            light.of_lanes(lane),
        )  # fmt: skip
        dr.eval(values)
        scale = dr.gather(mi.Float, self._scale, slot)
        first = dr.arange(mi.UInt32, width)
        return [
            Splat(
                fiber * self.targets.count + site * self.faces + k,
                [
                    scale * dr.gather(mi.Float, value, first + k * lanes)
                    for value in (values[k] for k in self._kept)
                ],
            )
            for k in range(self.faces)
        ]

    def _radiance(
        self, target: mi.UInt32, fiber: mi.UInt32, vertices: DrawnVertices, lane: mi.UInt32,
        face: mi.UInt32, camera: Stream, light: Stream,
    ) -> list[mi.Float]:  # fmt: skip
        """Return the radiance per direction node that one camera subpath per target finds."""
        first = 1 + face * self.stride
        pick_pixel, _, x, y = camera.event(first)
        column, row = self.pixels.place(target, pick_pixel, x, y)
        film = self.scene.camera
        subpath = self.camera_subpath(
            column, row, (film.columns, film.rows), camera, first + 1, fiber
        )
        return self.radiance(vertices, lane, subpath, light, face, fiber)


class PictureSampler(PadSampler):
    """All pixels of a picture of one design: bins are pixels, channels the camera's."""

    stored = (CAMERA_STORED, PICTURE_LIGHT_PATHS, LIGHT_STORED)

    def __init__(
        self,
        scene: Scene,
        phi: Array,
        power: Array,
        bend: float,
        indented: bool,
        width: int,
        height: int,
    ) -> None:
        """Load the pad; ``phi`` ``(fiber,)`` rad, ``power`` ``(fiber, channel)``, ``bend`` rad."""
        super().__init__(scene, phi[:, None], bend, indented)
        self.width, self.height = width, height
        self.bins = width * height
        lit = np.nonzero(power.max(axis=1) > 0)[0]
        self.lit = len(lit)
        self._fiber = mi.UInt32(lit.astype(np.uint32))
        self.channels = power.shape[1]
        self._power = [mi.Float(column.astype(np.float32)) for column in power.T]
        self._counts = [mi.Float(n) for n in (width, height, self.lit)]
        dr.make_opaque(self._fiber, self._power, self._counts)

    def evaluate(self, camera: Stream, light: Stream) -> list[Splat]:
        """Return one splat per lane: radiance per channel, over the bin's probability."""
        x, y, pick, _ = camera.event(mi.UInt32(0))
        width, height, lit = self._counts
        chosen = dr.minimum(mi.UInt32(pick * lit), mi.UInt32(lit) - 1)
        fiber = dr.gather(mi.UInt32, self._fiber, chosen)
        column = dr.minimum(mi.UInt32(x * width), mi.UInt32(width) - 1)
        row = dr.minimum(mi.UInt32(y * height), mi.UInt32(height) - 1)
        subpath = self.camera_subpath(
            x * width, y * height, (self.width, self.height), camera, mi.UInt32(1), fiber
        )
        dr.eval(subpath)
        coated = subpath.facet.weight > 0
        seen = dr.select(coated, subpath.facet, subpath.end.vertex)
        point, normal = seen.p, mi.Vector3f(seen.n)
        vertices = self.light_vertices(point, normal, fiber, light, PICTURE_LIGHT_PATHS)
        lane = dr.arange(mi.UInt32, dr.width(fiber))
        value = self.radiance(vertices, lane, subpath, light, mi.UInt32(0), fiber)[0]
        scale = lit * width * height
        colors = [value * scale * dr.gather(mi.Float, power, fiber) for power in self._power]
        return [Splat(row * mi.UInt32(width) + column, colors)]


def filled_up(scene: Scene, nodes: int) -> np.ndarray:
    """Return which node each of a multiple of `NODES` is, in order, so that strata stay theirs.

    Lamps that do not turn have one node in all renders.
    """
    if not any(scene.turning):
        return np.arange(nodes)
    filled = -(-nodes // NODES) * NODES
    return np.arange(filled) * nodes // filled


def _points(array: Array) -> mi.Point3f:
    """Return ``(n, 3)`` as n points."""
    return mi.Point3f(*(mi.Float(column) for column in array.T.astype(np.float32)))
