"""What a photograph says along the reference lines."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hw.calibration.material_table import line_pixels, sample
from hw.pinhole import intrinsics, rotation
from hw.projection import pad_positions
from render.bending import Array
from render.scene import Scene

BOX = 5
"""Side (pixels) of the square that is averaged around every point."""
LEAST, MOST = 3.0, 225.0
"""Counts between which a point is used."""
STEP = 2e-3
"""Turn (rad) over which the slope with the camera's tilt is taken."""


@dataclass(frozen=True, eq=False)
class Measurement:
    """One photograph of one fiber.

    Arguments:
        fiber: its number; bend: index of the bend.
        counts: ``(point, 3)`` linear, dark frame subtracted; NaN where unseen.
        used: ``(point,)`` which points count.
        channels: that carry light.
        noise: standard deviation of ``counts``.
        radius2: ``(point,)`` squared distance from the image's middle, 1 in the corners.
        tilt_slope: ``(3, point, 3)`` change of counts per rad of the camera's tilt undone.
    """

    fiber: int
    bend: int
    counts: Array
    used: NDArray[np.bool_]
    channels: list[int]
    noise: float
    radius2: Array
    tilt_slope: Array


def _well_inside(positions: Array) -> NDArray[np.bool_]:
    """Return the pixels ``(row, column)`` around which everything that is averaged is pad."""
    import cv2

    pad = np.isfinite(positions[..., 0]).astype(np.uint8)
    reach = np.ones((BOX + 6, BOX + 6), dtype=np.uint8)
    inside = cv2.erode(pad, reach, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    return np.asarray(inside, dtype=np.bool_)


class LineReader:
    """Reads reference lines off photographs; positions are found once per bend.

    Arguments:
        scene: the sensor.
        bends: ``(bend,)`` rad.
        noise: standard deviation of one pixel in counts.
    """

    def __init__(self, scene: Scene, bends: Array, noise: float) -> None:
        """Find the image positions of all points."""
        self._scene, self._noise = scene, noise
        rows, columns = scene.camera.rows, scene.camera.columns
        pixels = line_pixels(scene, bends, rows, columns)
        for index, bend in enumerate(bends):
            whole = _well_inside(pad_positions(scene, float(bend), rows, columns))
            place = np.nan_to_num(pixels[index]).astype(int)
            seen = whole[
                np.clip(place[..., 1], 0, rows - 1), np.clip(place[..., 0], 0, columns - 1)
            ]
            pixels[index] = np.where(seen[..., None], pixels[index], np.nan)
        self._pixels = pixels

    def read(self, photo: Array, fiber: int, bend: int) -> Measurement:
        """Return the lines of ``fiber`` in ``photo`` ``(row, column, 3)`` at a bend's index."""
        import cv2

        smooth: Array = np.asarray(
            cv2.blur(photo, (BOX, BOX), borderType=cv2.BORDER_REPLICATE), dtype=np.float64
        )
        pixels = self._pixels[bend, fiber]
        counts = sample(smooth, pixels)
        wide: Array = np.asarray(cv2.GaussianBlur(smooth, (0, 0), 2.0), dtype=np.float64)
        slopes = np.stack(
            [
                (sample(wide, self._turned(pixels, axis)) - sample(wide, pixels)) / STEP
                for axis in range(3)
            ]
        )
        rows, columns = photo.shape[:2]
        middle = np.array([columns / 2, rows / 2])
        radius2 = ((pixels - middle) ** 2).sum(axis=1) / (middle**2).sum()
        bright = np.nanpercentile(counts, 90, axis=0)
        channels = [c for c in range(3) if bright[c] > max(2 * LEAST, 0.1 * bright.max())]
        with np.errstate(invalid="ignore"):
            fits = (counts[:, channels] > LEAST) & (counts[:, channels] < MOST)
        used = np.isfinite(slopes).all(axis=(0, 2)) & np.all(fits, axis=1)
        slopes = np.where(used[None, :, None], slopes, 0.0)
        return Measurement(fiber, bend, counts, used, channels, self._noise / BOX, radius2, slopes)

    def _turned(self, pixels: Array, axis: int) -> Array:
        """Return where ``pixels`` ``(n, 2)`` lie after the camera has turned by `STEP`."""
        columns, rows = self._scene.camera.columns, self._scene.camera.rows
        matrix = intrinsics(self._scene, columns, rows)
        tilt = tuple(STEP if a == axis else 0.0 for a in range(3))
        turn = rotation(tilt)  # type: ignore[arg-type]
        homogeneous = np.concatenate([pixels - 0.5, np.ones((len(pixels), 1))], axis=1)
        moved = homogeneous @ (matrix @ np.linalg.inv(turn) @ np.linalg.inv(matrix)).T
        return np.asarray(moved[:, :2] / moved[:, 2:] + 0.5)
