"""The scene's pinhole, and where on the pad its pixels look."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hw.errors import CalibrationError
from render.arrays import Array
from render.geometry import (
    camera_origin,
    distance_to_coating,
    pixel_directions,
    refract_into_pad,
    unbend_points,
)
from tactilux import Scene

NEWTON_STEPS = 12
TOLERANCE_MM = 1e-3
"""Newton steps stop when all points are met this well (mm)."""


def intrinsics(scene: Scene, columns: int, rows: int) -> Array:
    """Return the pinhole matrix ``(3, 3)`` of the scene's camera in OpenCV's form.

    Positions count from the middle of the first pixel; the field of view spans all rows.
    """
    focal = 0.5 * rows / np.tan(scene.camera.field_of_view / 2)
    return np.array(
        [[focal, 0.0, 0.5 * columns - 0.5], [0.0, focal, 0.5 * rows - 0.5], [0.0, 0.0, 1.0]]
    )


def rotation(tilt: Sequence[float] | Array) -> Array:
    """Return the matrix that turns by ``tilt`` (rad) about x, then y, then the viewing axis.

    Every turn leads the first of the other two axes towards the second, in the order x, y, z.
    About x (y to z) and z (x to y) that is right-handed; about y (x to z) it is left-handed, so
    that the same sign of the first two tilts moves the picture the same way along both its axes.
    """
    from scipy.spatial.transform import Rotation

    about_x, about_y, about_z = tilt
    return np.asarray(Rotation.from_euler("xyz", [about_x, -about_y, about_z]).as_matrix())


def flat_positions(scene: Scene, bend: float, directions: Array) -> Array:
    """Return where rays ``(..., 3)`` from the pinhole meet the coating, ``(..., 2)`` flat x, y mm.

    NaN where a ray misses the pad.
    """
    rays = refract_into_pad(scene, bend, camera_origin(scene), directions)
    way = distance_to_coating(scene, bend, rays)
    met = rays.inside & np.isfinite(way)
    point = rays.entry + np.where(met, way, 0.0)[..., None] * rays.direction
    flat = unbend_points(scene, point, bend)[..., :2]
    return np.where(met[..., None], flat, np.nan)


def pad_positions(scene: Scene, bend: float, rows: int, columns: int) -> Array:
    """Return flat x, y (mm) that pixel centers look at, ``(row, column, 2)``, NaN off the pad."""
    row, column = np.meshgrid(np.arange(rows) + 0.5, np.arange(columns) + 0.5, indexing="ij")
    return flat_positions(scene, bend, pixel_directions(scene, columns, rows, column, row))


def pixels_of(scene: Scene, bend: float, points: Array, rows: int, columns: int) -> Array:
    """Return image positions ``(n, 2)`` (column, row in pixels) that look at ``points`` ``(n, 2)``.

    Newton's iteration from the nearest of a coarse grid of pixels; NaN where the camera cannot
    see a point.

    Raises:
        CalibrationError: no pixel looks at the pad at all.
    """
    grid_row, grid_column = np.meshgrid(
        np.linspace(0, rows, 61), np.linspace(0, columns, 41), indexing="ij"
    )
    place = np.stack([grid_column.ravel(), grid_row.ravel()], axis=-1)

    def looks_at(pixel: Array) -> Array:
        directions = pixel_directions(scene, columns, rows, pixel[..., 0], pixel[..., 1])
        return flat_positions(scene, bend, directions)

    seen = looks_at(place)
    wanted = np.all(np.isfinite(points), axis=1)[:, None]
    points = np.where(wanted, points, 0.0)
    seen_places = place[np.isfinite(seen[:, 0])]
    seen = seen[np.isfinite(seen[:, 0])]
    if not len(seen):
        raise CalibrationError(
            f"the camera does not see the pad at a bend of {np.degrees(bend):g} deg: choose "
            "another",
            field="bend",
        )
    nearest = np.argmin(np.linalg.norm(seen[None] - points[:, None], axis=-1), axis=1)
    pixel = seen_places[nearest]
    step = 0.25
    for _ in range(NEWTON_STEPS):
        here = looks_at(pixel)
        right = (looks_at(pixel + [step, 0.0]) - here) / step
        down = (looks_at(pixel + [0.0, step]) - here) / step
        miss = points - here
        if np.nanmax(np.abs(miss), initial=0.0) < TOLERANCE_MM:
            break
        det = right[:, 0] * down[:, 1] - right[:, 1] * down[:, 0]
        move = np.stack(
            [
                (miss[:, 0] * down[:, 1] - miss[:, 1] * down[:, 0]) / det,
                (right[:, 0] * miss[:, 1] - right[:, 1] * miss[:, 0]) / det,
            ],
            axis=-1,
        )
        pixel = pixel + np.clip(move, -40.0, 40.0)
    away = np.linalg.norm(points - looks_at(pixel), axis=-1)
    inside = (pixel >= 0).all(axis=1) & (pixel[:, 0] <= columns) & (pixel[:, 1] <= rows)
    return np.where(wanted & ((away < 10 * TOLERANCE_MM) & inside)[:, None], pixel, np.nan)
