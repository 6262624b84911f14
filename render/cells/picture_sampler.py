"""A lit sensor's picture as a sampling problem: bins are pixels, channels are red, green, blue."""

from __future__ import annotations

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
from render.cells.light_vertex_picks import light_picks
from render.cells.lower_face_mirror import Bridge
from render.cells.resampling import Promise
from render.optics.pad_scene import pad_scene, with_min_roughness
from render.sampling.proposals import Splat
from render.scene import Scene

LIGHT_PATHS = 2


class PictureSampler:
    """All pixels of a picture of one design; see ``render.sampling.proposals.PathSampler``."""

    stored = (10, LIGHT_PATHS, 10)
    channels = 3

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
        """Load the pad; ``phi`` ``(fiber,)`` rad, ``power`` ``(fiber, 3)``, ``bend`` rad."""
        scene = with_min_roughness(scene)
        self.scene, self.width, self.height = scene, width, height
        self.bins = width * height
        self.pad = pad_scene(scene, bend, indented)
        self.light = FiberLight(scene, phi[:, None], bend)
        self.guide, self.bridge = Guide(scene, bend), Bridge(scene, bend)
        self.promise = Promise(scene, bend, self.bridge)
        lit = np.nonzero(power.max(axis=1) > 0)[0]
        self.lit = len(lit)
        self._fiber = mi.UInt32(lit.astype(np.uint32))
        self._power = [mi.Float(power[:, c].astype(np.float32)) for c in range(3)]
        dr.make_opaque(self._fiber, self._power)

    def evaluate(self, camera: Any, light: Any) -> list[Splat]:
        """Return one deposit per lane: radiance per color, over the bin's probability."""
        x, y, pick, _ = camera.event(mi.UInt32(0))
        chosen = dr.minimum(mi.UInt32(pick * self.lit), self.lit - 1)
        fiber = dr.gather(mi.UInt32, self._fiber, chosen)
        column = dr.minimum(mi.UInt32(x * self.width), self.width - 1)
        row = dr.minimum(mi.UInt32(y * self.height), self.height - 1)
        o, d = pixel_rays(self.scene, x * self.width, y * self.height, self.width, self.height)
        aim = FacetAim(self.guide, fiber)
        seen = camera_subpath(self.pad, o, d, camera, mi.UInt32(1), aim, self.bridge)
        dr.eval(seen)
        coated = seen.facet.weight > 0
        point = dr.select(coated, seen.facet.p, seen.end.p)
        normal = mi.Vector3f(dr.select(coated, seen.facet.n, seen.end.n))
        picks = light_picks(
            self.pad, self.promise, point, normal, self.light, fiber, light, LIGHT_PATHS
        )
        lane = dr.arange(mi.UInt32, dr.width(fiber))
        value = joined_nodes(self.pad, picks, lane, seen, light, mi.UInt32(0), aim, self.bridge)[0]
        scale = self.lit * self.bins
        colors = [value * scale * dr.gather(mi.Float, power, fiber) for power in self._power]
        return [Splat(row * self.width + column, colors)]
