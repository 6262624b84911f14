"""What all rigs of one design share: nothing in it depends on photographs or on the material."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hw.calibration.material import HIGH, LOW, Material
from hw.calibration.reference_lines import ReferenceLines, reference_lines
from hw.camera.projection import pixels_of
from render.arrays import Array
from tactilux import Scene


@dataclass(frozen=True, eq=False)
class Setup:
    """A sensor as it is photographed.

    Arguments:
        scene: the sensor.
        phi: ``(fiber,)`` rad, where its fibers point.
        bends: ``(bend,)`` rad, at which it is photographed.
    """

    scene: Scene
    phi: Array
    bends: Array

    @cached_property
    def lines(self) -> ReferenceLines:
        """The reference lines of all fibers."""
        return reference_lines(self.scene)

    def of(self, material: Array) -> Setup:
        """Return the same sensor made of ``(4,)`` material."""
        return replace(self, scene=Material.from_array(material).put_into(self.scene))

    def key(self, version: int, *details: object) -> str:
        """Return a hash of all this but the material, and of ``details``."""
        neutral = self.of(np.sqrt(LOW * HIGH) + 0.01).scene
        content = [version, neutral.hash, np.round(self.phi, 9).tolist(),
                   np.round(self.bends, 9).tolist(), *details]  # fmt: skip
        return hashlib.sha256(json.dumps(content).encode()).hexdigest()[:16]

    def line_pixels(self, rows: int, columns: int) -> Array:
        """Return where the lines are in images, ``(bend, fiber, point, 2)``, NaN where unseen."""
        points = self.lines.on_pad
        pixels = [
            pixels_of(self.scene, float(bend), points.reshape(-1, 2), rows, columns)
            for bend in self.bends
        ]
        return np.stack(pixels).reshape(-1, *points.shape)
