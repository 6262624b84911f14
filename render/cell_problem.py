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
from render.camera_rays import pixel_rays
from render.cell_camera import camera_subpath
from render.cell_paths import light_subpaths
from render.chains import Deposit
from render.fiber_light import FiberLight
from render.guide import FacetAim, Guide
from render.optics import pad_scene
from render.resampling import Promise
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
        self.promise = Promise(scene, bend, self.bridge)
        self.targets = targets
        self.fibers, self.channels = phi.shape
        self.bins = self.fibers * targets.count
        # One more entry: a target without pixels at the end reads past the others'.
        self._pixel = mi.UInt32(np.append(targets.pixel, 0).astype(np.uint32))
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
        film = self.scene.camera
        row = pixel // film.columns
        column = pixel - row * film.columns
        o, d = pixel_rays(
            self.scene, mi.Float(column) + x, mi.Float(row) + y, film.columns, film.rows
        )
        aim = FacetAim(self.guide, fiber)
        seen = camera_subpath(self.pad, o, d, camera, FIRST_CAMERA_EVENT, aim, self.bridge)
        values = light_subpaths(
            self.pad,
            seen,
            self.light,
            fiber,
            light,
            LIGHT_PATHS,
            aim,
            self.bridge,
            self.promise,
        )
        return [Deposit(fiber * count + target, [value * self.bins for value in values])]
