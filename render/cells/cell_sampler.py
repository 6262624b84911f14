"""Transport cells as a sampling problem: fiber and facet are extra primary dimensions.

One run fills ``T[fiber, node, target]``: primary numbers choose the site, the fiber, a pixel inside
the mask of each of the site's targets (its facets, or the untouched pad), and everything along the
paths. The same light paths serve all direction nodes of the fiber (``render.cells.fiber_light``)
and all facets of the site, so errors of facets of one site are correlated; those of sites are not.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from render.arrays import Array
from render.cells.camera_rays import pixel_rays
from render.cells.cell_connections import joined_nodes
from render.cells.facet_subpaths import camera_subpath
from render.cells.fiber_light import FiberLight
from render.cells.guiding import FacetAim, Guide
from render.cells.light_vertex_picks import LightPicks, light_picks
from render.cells.lower_face_mirror import Bridge
from render.cells.resampling import Promise
from render.geometry import facets, fiber_poses
from render.optics.pad_scene import pad_scene, with_min_roughness
from render.sampling.proposals import Splat
from render.scene import Scene

LIGHT_PATHS = 4
CAMERA_STORED = 10
LIGHT_STORED = 10
# Fibers are chosen by slots of equal probability. This share of them falls to all fibers alike, so
# that dim ones are known as well; the rest to near ones, which make the colors.
SLOTS, EVEN = 512, 0.4
# Events by which the camera subpaths of one lane are apart.
CAMERA_STRIDE = 40


@dataclass(frozen=True)
class Targets:
    """What is looked at: each target owns ``pixel[offset[t]:offset[t + 1]]`` (int64 arrays)."""

    pixel: np.ndarray
    offset: np.ndarray

    @property
    def count(self) -> int:
        """Number of targets."""
        return len(self.offset) - 1


def fiber_slots(site: Array, fiber: Array, lit: np.ndarray | None = None) -> np.ndarray:
    """Return the fiber of every slot, ``(site, SLOTS)``, from positions ``(site | fiber, 3)`` mm.

    Every fiber gets slots in proportion to ``EVEN`` shares plus the inverse square of its distance.
    Where ``lit`` ``(site, fiber)`` is given, only its fibers get any at a site that has some.
    """
    chosen = np.ones((len(site), len(fiber)))
    if lit is not None:
        chosen = np.where(lit.any(axis=1, keepdims=True), lit, chosen)
    near = chosen / ((site[:, None] - fiber[None]) ** 2).sum(axis=-1)
    share = EVEN * chosen / chosen.sum(axis=1, keepdims=True)
    share = share + (1.0 - EVEN) * near / near.sum(axis=1, keepdims=True)
    middle = (np.arange(SLOTS) + 0.5) / SLOTS
    edges = np.cumsum(share, axis=1)
    return np.stack([np.searchsorted(row / row[-1], middle) for row in edges])


class CellSampler:
    """All cells of one pad (one bend, indented or untouched) (``render.sampling.proposals``)."""

    stored = (CAMERA_STORED, LIGHT_PATHS, LIGHT_STORED)

    def __init__(
        self,
        scene: Scene,
        phi: Array,
        bend: float,
        indented: bool,
        targets: Targets,
        lit: np.ndarray | None = None,
    ) -> None:
        """Load the pad and upload targets; ``phi`` is ``(fiber, node)`` rad, ``bend`` rad.

        ``lit`` ``(site, fiber)`` may leave out fibers (`fiber_slots`); their cells stay 0.
        """
        scene = with_min_roughness(scene)
        self.scene = scene
        self.pad = pad_scene(scene, bend, indented)
        self.light = FiberLight(scene, phi, bend)
        self.guide = Guide(scene, bend)
        self.bridge = Bridge(scene, bend)
        self.promise = Promise(scene, bend, self.bridge)
        self.targets = targets
        self.fibers, self.channels = phi.shape
        self.sites = scene.sites.count
        self.faces = targets.count // self.sites
        self.bins = self.fibers * targets.count
        place = facets(scene, bend)
        self._point = _points(place.centroid.mean(axis=1) if indented else place.site_position)
        self._normal = mi.Vector3f(_points(place.site_normal))
        slots = fiber_slots(place.site_position, fiber_poses(scene, bend).position, lit)
        self._fiber = mi.UInt32(slots.astype(np.uint32).ravel())
        shares = np.stack([np.bincount(row, minlength=self.fibers)[row] for row in slots])
        self._scale = mi.Float((self.sites * SLOTS / shares).astype(np.float32).ravel())
        # One more entry: a target without pixels at the end reads past the others'.
        self._pixel = mi.UInt32(np.append(targets.pixel, 0).astype(np.uint32))
        self._offset = mi.UInt32(targets.offset.astype(np.uint32))
        dr.make_opaque(
            self._pixel, self._offset, self._point, self._normal, self._fiber, self._scale
        )

    def evaluate(self, camera: Any, light: Any) -> list[Splat]:
        """Return a deposit per facet of the chosen site: radiance per direction node."""
        pick_site, pick_fiber, _, _ = camera.event(mi.UInt32(0))
        site = dr.minimum(mi.UInt32(pick_site * self.sites), self.sites - 1)
        slot = site * SLOTS + dr.minimum(mi.UInt32(pick_fiber * SLOTS), SLOTS - 1)
        fiber = dr.gather(mi.UInt32, self._fiber, slot)
        picks = light_picks(
            self.pad, self.promise, dr.gather(mi.Point3f, self._point, site),
            dr.gather(mi.Vector3f, self._normal, site), self.light, fiber, light, LIGHT_PATHS,
        )  # fmt: skip
        # From here on one lane per facet: all facets of a site share its light subpaths.
        lanes = dr.width(site)
        wide: Any = dr.arange(mi.UInt32, lanes * self.faces)
        face = wide // lanes
        lane = wide - face * lanes
        values = self._seen(
            dr.gather(mi.UInt32, site, lane) * self.faces + face,
            dr.gather(mi.UInt32, fiber, lane), picks, lane, face, camera.spread(lane),
            light.spread(lane),
        )  # fmt: skip
        dr.eval(values)
        scale = dr.gather(mi.Float, self._scale, slot)
        first = dr.arange(mi.UInt32, lanes)
        return [
            Splat(
                fiber * self.targets.count + site * self.faces + k,
                [scale * dr.gather(mi.Float, value, first + k * lanes) for value in values],
            )
            for k in range(self.faces)
        ]

    def _seen(
        self, target: Any, fiber: Any, picks: LightPicks, lane: Any, face: Any, camera: Any,
        light: Any,
    ) -> list[Any]:  # fmt: skip
        """Return the radiance per direction node that one camera subpath per target finds."""
        first = 1 + face * CAMERA_STRIDE
        pick_pixel, _, x, y = camera.event(first)
        begin = dr.gather(mi.UInt32, self._offset, target)
        size = dr.gather(mi.UInt32, self._offset, target + 1) - begin
        within = dr.minimum(mi.UInt32(pick_pixel * mi.Float(size)), dr.maximum(size, 1) - 1)
        pixel = dr.gather(mi.UInt32, self._pixel, begin + within)
        film = self.scene.camera
        row = pixel // film.columns
        column = pixel - row * film.columns
        o, d = pixel_rays(
            self.scene, mi.Float(column) + x, mi.Float(row) + y, film.columns, film.rows
        )
        aim = FacetAim(self.guide, fiber)
        seen = camera_subpath(self.pad, o, d, camera, first + 1, aim, self.bridge)
        return joined_nodes(self.pad, picks, lane, seen, light, face, aim, self.bridge)


def _points(array: Array) -> Any:
    """Return ``(n, 3)`` as n points."""
    return mi.Point3f(*(mi.Float(column) for column in array.T.astype(np.float32)))
