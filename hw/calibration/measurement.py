"""What a photograph says along the reference lines."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hw.calibration.reference_lines import Setup, sample_image
from hw.camera.projection import pad_positions, rotation
from render.arrays import Array
from render.geometry import lens_directions, lens_positions

BOX_PIXELS = 5
"""Side (pixels) of the square that is averaged around every point."""
CLEARANCE_PIXELS = 12
"""Pixels around a point that must show the pad: beyond its outline there is no light, and so far
extend the averages, their slopes, and a camera that is tilted by half a degree."""
OUTLINE_PIXELS = 4
"""Pixels from the pad's outline that the averages leave out."""
MIN_COUNTS, MAX_COUNTS = 3.0, 225.0
"""Counts between which a point is used."""
SLOPE_BLUR_PIXELS = 6.0
"""Standard deviation (pixels) of the average from which slopes are taken. Their noise must stay far
below them: the fit would take it for light that does not move with the tilt."""
TILT_STEP = 2e-3
"""Turn (rad) over which the slope with the camera's tilt is taken."""


@dataclass(frozen=True, eq=False)
class Measurement:
    """One photograph of one fiber.

    Arguments:
        fiber: its number; bend: index of the bend.
        counts: ``(point, channel)`` linear, dark frame subtracted; NaN where unseen.
        used: ``(point,)`` which points count.
        channels: that carry light.
        noise: standard deviation of ``counts``.
        radius2: ``(point,)`` squared distance from the image's middle, 1 in the corners.
        tilt_slope: ``(3, point, channel)`` change of counts per rad of the camera's tilt undone.
    """

    fiber: int
    bend: int
    counts: Array
    used: NDArray[np.bool_]
    channels: list[int]
    noise: float
    radius2: Array
    tilt_slope: Array

    def untilted(self, tilt: Array) -> Array:
        """Return counts ``(point, channel)`` as without the camera's ``tilt`` ``(3,)`` rad."""
        return np.asarray(self.counts + np.einsum("tpc,t->pc", self.tilt_slope, tilt))


def _well_inside(positions: Array, margin: int) -> NDArray[np.bool_]:
    """Return the pixels ``(row, column)`` around which ``margin`` pixels show the pad."""
    import cv2

    pad = np.isfinite(positions[..., 0]).astype(np.uint8)
    square = np.ones((2 * margin + 1, 2 * margin + 1), dtype=np.uint8)
    inside = cv2.erode(pad, square, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    return np.asarray(inside, dtype=np.bool_)


def _averaged(photo: Array, inside: NDArray[np.bool_]) -> Array:
    """Return the Gaussian average of those pixels of ``photo`` that are ``inside``."""
    import cv2

    weight = cv2.GaussianBlur(inside.astype(np.float64), (0, 0), SLOPE_BLUR_PIXELS)
    blurred = cv2.GaussianBlur(photo * inside[..., None], (0, 0), SLOPE_BLUR_PIXELS)
    # OpenCV drops the axis of a lone channel.
    return np.asarray(blurred.reshape(photo.shape) / np.maximum(weight, 1e-6)[..., None])


class LineReader:
    """Reads reference lines off photographs; positions are found once per bend.

    ``noise`` is the standard deviation of one pixel in counts.
    """

    def __init__(self, setup: Setup, noise: float) -> None:
        self._scene, self._noise = setup.scene, noise
        rows, columns = setup.scene.camera.rows, setup.scene.camera.columns
        self._pixels = setup.line_pixels(rows, columns)
        self._clear = []
        for pixels, bend in zip(self._pixels, setup.bends, strict=True):
            shown = pad_positions(setup.scene, float(bend), rows, columns)
            whole = _well_inside(shown, CLEARANCE_PIXELS)
            self._clear.append(_well_inside(shown, OUTLINE_PIXELS))
            column, row = np.moveaxis(np.nan_to_num(pixels).astype(int), -1, 0)
            pixels[~whole[np.clip(row, 0, rows - 1), np.clip(column, 0, columns - 1)]] = np.nan

    def read(self, photo: Array, fiber: int, bend: int) -> Measurement:
        """Return the lines of ``fiber`` in ``photo`` at a bend's index.

        The photograph is ``(row, column, channel)``.
        """
        import cv2

        box = (BOX_PIXELS, BOX_PIXELS)
        blurred = cv2.blur(photo, box, borderType=cv2.BORDER_REPLICATE)
        smooth: Array = np.asarray(blurred, dtype=np.float64).reshape(photo.shape)
        wide = _averaged(photo, self._clear[bend])
        pixels = self._pixels[bend, fiber]
        counts, here = sample_image(smooth, pixels), sample_image(wide, pixels)
        turned = (sample_image(wide, self._turned(pixels, axis)) for axis in range(3))
        slopes = np.stack([(there - here) / TILT_STEP for there in turned])
        rows, columns = photo.shape[:2]
        middle = np.array([columns / 2, rows / 2])
        radius2 = ((pixels - middle) ** 2).sum(axis=1) / (middle**2).sum()
        bright = np.nanpercentile(counts, 90, axis=0)
        channels = [
            c for c in range(len(bright)) if bright[c] > max(2 * MIN_COUNTS, 0.1 * bright.max())
        ]
        with np.errstate(invalid="ignore"):
            fits = (counts[:, channels] > MIN_COUNTS) & (counts[:, channels] < MAX_COUNTS)
        used = np.isfinite(slopes).all(axis=(0, 2)) & np.all(fits, axis=1)
        slopes = np.where(used[None, :, None], slopes, 0.0)
        noise = self._noise / BOX_PIXELS
        return Measurement(fiber, bend, counts, used, channels, noise, radius2, slopes)

    def _turned(self, pixels: Array, axis: int) -> Array:
        """Return where ``pixels`` ``(n, 2)`` lie after the camera has turned by `TILT_STEP`."""
        scene, size = self._scene, (self._scene.camera.columns, self._scene.camera.rows)
        look = lens_directions(scene, *size, pixels[:, 0], pixels[:, 1])
        return lens_positions(scene, *size, look @ rotation(TILT_STEP * np.eye(3)[axis]))
