"""The camera's rays: from image positions to directions in the world, and back.

Image positions are continuous, column and row in pixels from the upper left corner. Camera frame:
right and down in the picture, and ahead. Pixels are square; ``camera.field_of_view`` is the full
angle over all rows. A pinhole's image is the tangent of the angle from the axis (Mitsuba's
perspective sensor), a fisheye's the angle itself (the equidistant projection, OpenCV's fisheye
model without distortion).
"""

from __future__ import annotations

import numpy as np

from render.arrays import Array
from render.scene import Scene


def camera_origin(scene: Scene) -> Array:
    """Return where the camera stands, ``(3,)`` in mm, the same at every bend."""
    return np.array(scene.camera.place)


def camera_axes(scene: Scene) -> Array:
    """Return the unit vectors right, down and ahead in the world, ``(axis, 3)``."""
    return np.array(scene.camera.axes)


def camera_rays(
    scene: Scene, columns: int, rows: int, offset: tuple[float, float] = (0.5, 0.5)
) -> tuple[Array, Array]:
    """Return the camera's place ``(3,)`` mm and unit directions ``(rows, columns, 3)`` of pixels.

    ``offset`` is the position ``(x, y)`` within each pixel, in [0, 1]; 0.5 is its center.
    """
    row, column = np.meshgrid(
        np.arange(rows, dtype=np.float64), np.arange(columns, dtype=np.float64), indexing="ij"
    )
    return camera_origin(scene), pixel_directions(
        scene, columns, rows, column + offset[0], row + offset[1]
    )


def pixel_directions(scene: Scene, columns: int, rows: int, column: Array, row: Array) -> Array:
    """Return unit directions ``(..., 3)`` in the world through image positions."""
    return lens_directions(scene, columns, rows, column, row) @ camera_axes(scene)


def pixel_positions(scene: Scene, columns: int, rows: int, directions: Array) -> Array:
    """Return image positions ``(..., 2)`` (column, row in pixels) of directions ``(..., 3)``.

    The inverse of `pixel_directions`; NaN for what lies behind a pinhole.
    """
    return lens_positions(scene, columns, rows, directions @ camera_axes(scene).T)


def lens_directions(scene: Scene, columns: int, rows: int, column: Array, row: Array) -> Array:
    """Return unit directions ``(..., 3)`` in the camera frame through image positions."""
    half_width, half_height = half_view(scene, columns, rows)
    x, y = half_width * (2 * column / columns - 1), half_height * (2 * row / rows - 1)
    if scene.camera.fisheye:
        angle = np.hypot(x, y)
        # np.sinc(a / pi) = sin(a) / a, 1 at a = 0.
        sine = np.sinc(angle / np.pi)
        return np.stack([sine * x, sine * y, np.cos(angle)], axis=-1)
    direction = np.stack([x, y, np.ones_like(x)], axis=-1)
    return np.asarray(direction / np.linalg.norm(direction, axis=-1, keepdims=True))


def lens_positions(scene: Scene, columns: int, rows: int, directions: Array) -> Array:
    """Return image positions ``(..., 2)`` of directions ``(..., 3)`` in the camera frame."""
    half_width, half_height = half_view(scene, columns, rows)
    x, y, z = np.moveaxis(directions, -1, 0)
    if scene.camera.fisheye:
        side = np.hypot(x, y)
        scale = np.arctan2(side, z) / np.where(side > 0, side, 1.0)
    else:
        scale = 1 / np.where(z > 0, z, np.nan)
    return np.stack(
        [columns * (scale * x / half_width + 1) / 2, rows * (scale * y / half_height + 1) / 2],
        axis=-1,
    )


def half_view(scene: Scene, columns: int, rows: int) -> tuple[float, float]:
    """Return the lens's image of half the columns and half the rows: tangents, or angles in rad."""
    half = float(scene.camera.field_of_view) / 2
    height = half if scene.camera.fisheye else float(np.tan(half))
    return height * columns / rows, height
