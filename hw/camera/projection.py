"""Where on the pad the scene's camera looks, and photographs of a lens made its own."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hw.camera.lens import Lens
from hw.errors import CalibrationError, CaptureError
from render.arrays import Array
from render.geometry import (
    SkinChart,
    camera_origin,
    distance_to_coating,
    lens_directions,
    pixel_directions,
    refract_into_pad,
)
from tactilux import Scene

NEWTON_STEPS = 12
MAX_MISSED = 0.02
"""Part of the flat pad that may lie outside a lens's photograph."""
TOLERANCE_MM = 1e-3
"""Newton steps stop when all points are met this well (mm)."""


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
    """Return where rays ``(..., 3)`` from the camera meet the coating, ``(..., 2)`` flat x, y mm.

    NaN where a ray misses the pad.
    """
    rays = refract_into_pad(scene, bend, camera_origin(scene), directions)
    way = distance_to_coating(scene, bend, rays)
    met = rays.inside & np.isfinite(way)
    point = rays.entry + np.where(met, way, 0.0)[..., None] * rays.direction
    flat = SkinChart(scene, bend).uv(point)
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


class Dewarp:
    """Turns photographs of a lens into those of the scene's camera; maps are made once."""

    def __init__(self, lens: Lens, scene: Scene) -> None:
        """Make the maps.

        Raises:
            CaptureError: the lens does not show the pad.
        """
        self._lens = lens
        columns, rows = scene.camera.columns, scene.camera.rows
        row, column = np.meshgrid(np.arange(rows) + 0.5, np.arange(columns) + 0.5, indexing="ij")
        where = lens.positions(lens_directions(scene, columns, rows, column, row))
        shows = np.isfinite(pad_positions(scene, 0.0, rows, columns)[..., 0])
        inside = (where > -0.5) & (where < [lens.columns - 0.5, lens.rows - 0.5])
        missed = float((shows & ~inside.all(axis=-1)).sum() / max(shows.sum(), 1))
        if missed > MAX_MISSED:
            raise CaptureError(
                f"through this lens {missed:.0%} of the pad lie outside the photograph or where "
                f"its distortion is not known, allowed: at most {MAX_MISSED:.0%}; calibrate the "
                "lens over the whole picture, or see that it is this camera's",
                field="lens",
            )
        self._x, self._y = where[..., 0].astype(np.float32), where[..., 1].astype(np.float32)

    def __call__(self, photo: Array) -> Array:
        """Return ``photo`` ``(row, column, channel)`` as the scene's camera would have taken it.

        Raises:
            CaptureError: a photograph of another size.
        """
        if photo.shape[:2] != (self._lens.rows, self._lens.columns):
            raise CaptureError(
                f"the photograph has {photo.shape[1]} x {photo.shape[0]} pixels, allowed: "
                f"{self._lens.columns} x {self._lens.rows} as the lens file says; capture at that "
                "size",
                field="capture",
            )
        return np.asarray(remapped(photo, self._x, self._y), dtype=np.float64)


def remapped(
    photo: NDArray[np.floating],
    x: NDArray[np.float32],
    y: NDArray[np.float32],
    *,
    replicate: bool = False,
) -> NDArray[np.floating]:
    """Return ``photo`` ``(row, column[, channel])`` at columns ``x`` and rows ``y``, linearly.

    Beyond its border it is 0, or goes on as it ends. OpenCV knows up to four channels.
    """
    import cv2

    border = cv2.BORDER_REPLICATE if replicate else cv2.BORDER_CONSTANT
    if photo.ndim == 3 and photo.shape[2] != 3:
        each = np.moveaxis(photo, -1, 0)
        return np.stack([remapped(one, x, y, replicate=replicate) for one in each], axis=-1)
    photo = np.ascontiguousarray(photo)
    return np.asarray(cv2.remap(photo, x, y, cv2.INTER_LINEAR, borderMode=border))
