"""Where on the pad the pixels of the scene's camera look, and photographs of a lens made its own.

A lens is a TOML file (``hw/README.md``), as `cv2.fisheye.calibrate` finds it.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field, TypeAdapter, ValidationError

from hw.errors import CalibrationError, CaptureError
from render.arrays import Array
from render.files import parse_toml, read_text
from render.geometry import (
    SkinChart,
    camera_origin,
    distance_to_coating,
    lens_directions,
    pixel_directions,
    refract_into_pad,
)
from render.refused_values import problem_sentence, value_place
from tactilux import Scene

NEWTON_STEPS = 12
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


Size = Annotated[int, Field(gt=0)]
Focal = Annotated[float, Field(gt=0.0)]


@dataclass(frozen=True)
class Lens:
    """A fisheye lens: theta_d = theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8).

    Arguments:
        columns, rows: size of its photographs.
        focal, center: pixels, along x and y.
        distortion: k1 to k4.
    """

    __pydantic_config__: ClassVar = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)

    columns: Size
    rows: Size
    focal: tuple[Focal, Focal]
    center: tuple[float, float]
    distortion: tuple[float, float, float, float]

    def positions(self, directions: Array) -> Array:
        """Return where directions ``(..., 3)`` (right, down, ahead) appear, ``(..., 2)`` pixels.

        Positions count from the middle of the first pixel, as in OpenCV.
        """
        side = np.hypot(directions[..., 0], directions[..., 1])
        theta = np.arctan2(side, directions[..., 2])
        powers = theta[..., None] ** [2, 4, 6, 8]
        bent = theta * (1.0 + powers @ np.array(self.distortion))
        scale = (bent / np.where(side > 0, side, 1.0))[..., None]
        return np.asarray(self.center + self.focal * (scale * directions[..., :2]))


def load_lens(path: Path) -> Lens:
    """Return the lens in a TOML file.

    Raises:
        CaptureError: unreadable, or a key is missing, unknown or out of range.
    """
    try:
        raw = _content(path)
        # In JSON, lists are tuples and numbers are what they are.
        return TypeAdapter(Lens).validate_json(json.dumps(raw, default=str))
    except ValidationError as error:
        problem = error.errors(include_url=False)[0]
        key = value_place(problem)
        reason = f"is no lens: {problem_sentence(problem)}; correct the file"
    raise CaptureError(f"{path} {reason}", field=key)


def _content(path: Path) -> dict[str, Any]:
    try:
        text = read_text(path)
    except ValueError as error:
        raise CaptureError(
            f"{path} {error}; give the TOML file of the lens", field="lens"
        ) from None
    try:
        return parse_toml(text)
    except ValueError as error:
        raise CaptureError(
            f"{path} cannot be read as a lens: {error}; give the TOML file of the lens",
            field="lens",
        ) from None


class Dewarp:
    """Turns photographs of a lens into those of the scene's camera; maps are made once."""

    def __init__(self, lens: Lens, scene: Scene) -> None:
        self._lens = lens
        columns, rows = scene.camera.columns, scene.camera.rows
        row, column = np.meshgrid(np.arange(rows) + 0.5, np.arange(columns) + 0.5, indexing="ij")
        where = lens.positions(lens_directions(scene, columns, rows, column, row))
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
