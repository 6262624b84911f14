"""Transport cells as a sampling problem: fiber and facet are extra primary dimensions.

One run fills ``T[fiber, node, target]``: primary numbers choose the target (a facet, or the
untouched pad at a site), the pixel inside its mask, the fiber, and everything along the path; all
direction nodes of the fiber are served by the same light paths (``render.fiber_light``).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from render.bending import Array
from render.bridge import Bridge
from render.camera import camera_origin
from render.cell_paths import camera_subpath, light_subpaths
from render.chains import Deposit
from render.fiber_light import FiberLight
from render.guide import FacetAim, Guide
from render.optics import pad_scene
from render.scene import Scene

LIGHT_PATHS = 4
CAMERA_STORED = 10
LIGHT_STORED = 10
FIRST_CAMERA_EVENT = 2


@dataclass(frozen=True)
class Targets:
    """What is looked at: each target owns ``pixel[offset[t]:offset[t + 1]]`` (int64 arrays)."""

    pixel: np.ndarray
    offset: np.ndarray

    @property
    def count(self) -> int:
        """Number of targets."""
        return len(self.offset) - 1


class CellProblem:
    """All cells of one pad (one bend, indented or untouched); see ``render.chains.Problem``."""

    stored = (CAMERA_STORED, LIGHT_PATHS, LIGHT_STORED)

    def __init__(
        self, scene: Scene, phi: Array, bend: float, indented: bool, targets: Targets
    ) -> None:
        """Load the pad and upload targets; ``phi`` is ``(fiber, node)`` rad, ``bend`` rad."""
        self.scene = scene
        self.pad = pad_scene(scene, bend, indented)
        self.light = FiberLight(scene, phi, bend)
        self.guide = Guide(scene, bend)
        self.bridge = Bridge(scene, bend)
        self.targets = targets
        self.fibers, self.channels = phi.shape
        self.bins = self.fibers * targets.count
        self._pixel = mi.UInt32(targets.pixel.astype(np.uint32))
        self._offset = mi.UInt32(targets.offset.astype(np.uint32))
        dr.make_opaque(self._pixel, self._offset)

    def evaluate(self, camera: Any, light: Any) -> list[Deposit]:
        """Return one deposit per lane: radiance per direction node, over the bin's probability."""
        pick_target, pick_pixel, x, y = camera.event(mi.UInt32(0))
        pick_fiber = camera.event(mi.UInt32(1))[0]
        count = self.targets.count
        target = dr.minimum(mi.UInt32(pick_target * count), count - 1)
        fiber = dr.minimum(mi.UInt32(pick_fiber * self.fibers), self.fibers - 1)
        begin = dr.gather(mi.UInt32, self._offset, target)
        size = dr.gather(mi.UInt32, self._offset, target + 1) - begin
        within = dr.minimum(mi.UInt32(pick_pixel * mi.Float(size)), size - 1)
        pixel = dr.gather(mi.UInt32, self._pixel, begin + within)
        o, d = self._rays(pixel, x, y)
        aim = FacetAim(self.guide, fiber)
        seen = camera_subpath(self.pad, o, d, camera, FIRST_CAMERA_EVENT, aim, self.bridge)
        values = light_subpaths(self.pad, seen, self.light, fiber, light, LIGHT_PATHS, aim, self.bridge)
        return [Deposit(fiber * count + target, [value * self.bins for value in values])]

    def _rays(self, pixel: Any, x: Any, y: Any) -> tuple[Any, Any]:
        """Return rays through a uniformly chosen point of each pixel."""
        camera = self.scene.camera
        row = pixel // camera.columns
        column = pixel - row * camera.columns
        half_height = float(np.tan(camera.field_of_view / 2))
        half_width = half_height * camera.columns / camera.rows
        u = 1 - 2 * (mi.Float(column) + x) / camera.columns
        v = 1 - 2 * (mi.Float(row) + y) / camera.rows
        d = dr.normalize(mi.Vector3f(u * half_width, v * half_height, 1.0))
        origin = mi.Point3f(*camera_origin(self.scene).tolist())
        return origin + dr.zeros(mi.Point3f, dr.width(pixel)), d
