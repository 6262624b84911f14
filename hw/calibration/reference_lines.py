"""Reference lines on the pad, as in Fig. 3.5: three across the light, one along it, per fiber.

Their points are the same in every fiber's frame: mm beside its axis, and from the pad's edge.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hw.calibration.material import MaterialSpace, material_space
from hw.camera.projection import pixels_of
from render.arrays import Array
from render.geometry import flat_fiber_poses
from tactilux import Scene

ACROSS_AT = (2.0, 5.0, 8.0)
"""Distances (mm) from the lit edge at which the lines across the light lie."""
ACROSS_HALF_LENGTH, ALONG_END = 6.0, 14.0
STEP = 0.5
MARGIN = 0.6
"""Distance (mm) kept from the pad's edges, where a photograph is blurred."""
NAMES = ("across, 2 mm", "across, 5 mm", "across, 8 mm", "along")


@dataclass(frozen=True, eq=False)
class ReferenceLines:
    """Points of the lines of every fiber.

    Arguments:
        position: ``(fiber, point, 2)`` flat x, y in mm.
        inside: ``(fiber, point)``, whether a point lies on the pad.
        line: ``(point,)`` number of the line, in the order of `NAMES`.
        place: ``(point,)`` mm along the line: from the fiber's axis, or from the edge.
    """

    position: Array
    inside: NDArray[np.bool_]
    line: NDArray[np.int64]
    place: Array

    @property
    def on_pad(self) -> Array:
        """Positions ``(fiber, point, 2)``, NaN beside the pad."""
        return np.where(self.inside[..., None], self.position, np.nan)


_ASIDE = np.arange(-ACROSS_HALF_LENGTH, ACROSS_HALF_LENGTH + STEP / 2, STEP)
_AWAY = np.arange(2.0, ALONG_END + STEP / 2, STEP)
_LINE = np.concatenate([np.repeat([0, 1, 2], len(_ASIDE)), np.full(len(_AWAY), 3)])


def frame_positions() -> Array:
    """Return the points ``(point, 2)`` mm in a fiber's frame: beside its axis, from the edge."""
    away = np.concatenate([np.repeat(ACROSS_AT, len(_ASIDE)), _AWAY])
    aside = np.concatenate([np.tile(_ASIDE, 3), np.zeros(len(_AWAY))])
    return np.stack([aside, away], axis=-1)


def reference_lines(scene: Scene) -> ReferenceLines:
    """Return the lines of a scene's fibers."""
    poses = flat_fiber_poses(scene)
    margin = (poses.gap + poses.layer)[:, None]
    line, (aside, away) = _LINE, frame_positions().T
    position = (
        poses.position[:, None]
        + (margin + away)[..., None] * poses.inward[:, None]
        + aside[None, :, None] * poses.along[:, None]
    )[..., :2]
    half = np.array([scene.pad.width, scene.pad.length]) / 2 - MARGIN
    inside: NDArray[np.bool_] = np.all(np.abs(position) <= half, axis=-1)
    return ReferenceLines(position, inside, line, np.where(line < 3, aside, away))


def in_frame(scene: Scene, fiber: int, position: Array) -> Array:
    """Return flat positions ``(..., 2)`` mm in a fiber's frame: beside its axis, from the edge."""
    poses = flat_fiber_poses(scene)
    offset = position - poses.position[fiber, :2]
    return np.stack(
        [
            offset @ poses.along[fiber, :2],
            offset @ poses.inward[fiber, :2] - poses.gap[fiber] - poses.layer[fiber],
        ],
        axis=-1,
    )


def sample_image(image: NDArray[np.floating], pixels: Array) -> Array:
    """Return ``image`` ``(row, column[, channel])`` at ``pixels`` ``(n, 2)``, NaN where they are.

    Linear between the middles of pixels.
    """
    from scipy.ndimage import map_coordinates

    seen = np.isfinite(pixels[:, 0])
    place = np.where(seen, pixels.T[::-1] - 0.5, 0.0)
    layers = np.atleast_3d(image).astype(np.float64)
    values = [
        map_coordinates(layer, place, order=1, mode="nearest") for layer in layers.T.swapaxes(1, 2)
    ]
    return np.where(seen[:, None], np.stack(values, axis=-1), np.nan).reshape(-1, *image.shape[2:])


@dataclass(frozen=True, eq=False)
class Setup:
    """A sensor as it is photographed.

    Its fibers point to ``phi`` ``(fiber,)`` rad; it is photographed at ``bends`` ``(bend,)`` rad.
    """

    scene: Scene
    phi: Array
    bends: Array

    @cached_property
    def lines(self) -> ReferenceLines:
        """The reference lines of all fibers."""
        return reference_lines(self.scene)

    @cached_property
    def space(self) -> MaterialSpace:
        """What is fitted of its material."""
        return material_space(self.scene)

    @cached_property
    def one_albedo(self) -> Setup:
        """The same sensor with one albedo in all channels: what light of a channel meets."""
        scene = self.scene
        return replace(self, scene=scene.one_albedo_scenes[0]) if scene.by_channel else self

    def of(self, material: Array) -> Setup:
        """Return the same sensor made of ``(quantity,)`` material."""
        return replace(self, scene=self.space.put_into(self.scene, material))

    def key(self, version: int, *details: object) -> str:
        """Return a hash of all this but the material, and of ``details``."""
        neutral = self.of(self.space.neutral).scene
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
