"""Beams of bare fiber ends, or what a thin diffuser lets pass unscattered, as point lights."""

from __future__ import annotations

import numpy as np

from render.arrays import Array
from render.geometry import fiber_edges, flat_fiber_poses
from render.preview.diffuser.cache import fiber_end_of
from render.scene import EDGES, Scene

BEAM_MARK = 4
"""Added to the number of a light's edge: the shader's mark of a beam."""


class Beams:
    """Fiber ends before the pad: seven points of each end face, seen through the pad's edge."""

    edge_albedo = 0.0
    nodes = None

    def __init__(self, scene: Scene) -> None:
        """Place the images of the fiber ends behind the edge."""
        fibers = scene.fibers
        self._scene = scene
        self._beam = fiber_end_of(scene)
        self.defines = {
            "BEAM": "1",
            "EMISSION_TEXELS": "1",
            "SOFT_RADIUS": f"{fibers.diameter / 2:.6f}",
        }
        poses = flat_fiber_poses(scene)
        # Rabinowitz and Richter's rule of degree 5 on the disk: its center and a hexagon.
        azimuth = np.pi / 3 * np.arange(6)
        ring = np.sqrt(2 / 3) * fibers.diameter / 2
        along = np.concatenate([[0.0], ring * np.cos(azimuth)])
        up = np.concatenate([[0.0], ring * np.sin(azimuth)])
        self._weight = np.array([0.25] + [0.125] * 6)
        # Seen from inside the pad the air gap looks longer by the index (paraxial image).
        image = poses.position - fibers.gap * (scene.pad.index - 1) * poses.inward
        place = image[:, None] + along[:, None] * poses.along[:, None]
        place[..., 2] += up
        margin = 1e-3 * scene.pad.thickness
        place[..., 2] = np.clip(place[..., 2], margin, scene.pad.thickness - margin)
        edge = np.array([EDGES.index(name) + BEAM_MARK for name in fiber_edges(scene)])
        number = np.broadcast_to(edge[:, None, None], (*place.shape[:2], 1))
        self.position = np.concatenate([place, number], axis=-1)

    def emission(self, phi: Array) -> Array:
        """Return beam direction in the edge's frame and peak intensity, ``(..., fiber, 7, 4)``."""
        beam = self._beam.directions(phi)
        shape = (*phi.shape, len(self._weight))
        peak = np.broadcast_to(self._weight * self._beam.peak_intensity, shape)
        beams = np.broadcast_to(beam[..., None, :], (*shape, 3))
        return np.concatenate([beams, peak[..., None]], axis=-1)

    def merged(self, phi: Array, power: Array) -> tuple[Array, Array]:
        """Return all end points of all fibers."""
        emission = np.broadcast_to(self.emission(phi), (3, *self.position.shape)).copy()
        emission[..., 3] *= power.T[..., None]
        return self.position.reshape(1, -1, 4), emission.reshape(3, -1, 4)
