"""Reference lines on the pad, as in Fig. 3.5: three across the light, one along it, per fiber."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from render.arrays import Array
from render.geometry.layout import flat_fiber_poses
from render.scene.schema import Scene

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


_SIDEWAYS = np.arange(-ACROSS_HALF_LENGTH, ACROSS_HALF_LENGTH + STEP / 2, STEP)
_ONWARDS = np.arange(2.0, ALONG_END + STEP / 2, STEP)
_LINE = np.concatenate([np.repeat([0, 1, 2], len(_SIDEWAYS)), np.full(len(_ONWARDS), 3)])


def frame_positions() -> Array:
    """Return the points ``(point, 2)`` mm in a fiber's frame: beside its axis, from the edge."""
    away = np.concatenate([np.repeat(ACROSS_AT, len(_SIDEWAYS)), _ONWARDS])
    aside = np.concatenate([np.tile(_SIDEWAYS, 3), np.zeros(len(_ONWARDS))])
    return np.stack([aside, away], axis=-1)


def reference_lines(scene: Scene) -> ReferenceLines:
    """Return the lines of a scene's fibers."""
    poses = flat_fiber_poses(scene)
    line, (aside, away) = _LINE, frame_positions().T
    # From the fiber's end to the pad's edge: the air gap and the diffuser.
    margin = scene.fibers.gap + (scene.diffuser.thickness if scene.diffuser else 0.0)
    position = (
        poses.position[:, None]
        + (margin + away)[None, :, None] * poses.inward[:, None]
        + aside[None, :, None] * poses.along[:, None]
    )[..., :2]
    half = np.array([scene.pad.width, scene.pad.length]) / 2 - MARGIN
    inside: NDArray[np.bool_] = np.all(np.abs(position) <= half, axis=-1)
    return ReferenceLines(position, inside, line, np.where(line < 3, aside, away))
