"""From a fisheye photograph to the scene's pinhole (OpenCV's fisheye model).

The lens is a TOML file (``hw/README.md``), as `cv2.fisheye.calibrate` finds it::

    columns = 640
    rows = 480
    focal = [300.0, 300.0]      # pixels
    center = [319.5, 239.5]     # pixels
    distortion = [0.0, 0.0, 0.0, 0.0]
"""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hw.camera.projection import intrinsics
from hw.errors import CaptureError
from render.arrays import Array
from tactilux import Scene

KEYS = {"columns": 1, "rows": 1, "focal": 2, "center": 2, "distortion": 4}


@dataclass(frozen=True)
class Lens:
    """A fisheye lens: theta_d = theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8).

    Arguments:
        columns, rows: size of its photographs.
        focal, center: pixels, along x and y.
        distortion: k1 to k4.
    """

    columns: int
    rows: int
    focal: tuple[float, float]
    center: tuple[float, float]
    distortion: tuple[float, float, float, float]

    @property
    def matrix(self) -> Array:
        """The pinhole part ``(3, 3)``."""
        (fx, fy), (cx, cy) = self.focal, self.center
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def load_lens(path: Path) -> Lens:
    """Return the lens in a TOML file.

    Raises:
        CaptureError: unreadable, or a key is missing, unknown or out of range.
    """
    try:
        raw = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise CaptureError(
            f"{path} cannot be read as a lens: {error}; give the TOML file of the lens",
            field="lens",
            value=str(path),
        ) from None
    for key, count in KEYS.items():
        value = raw.get(key)
        numbers = value if isinstance(value, list) else [value]
        good = (
            len(numbers) == count
            and isinstance(value, list) == (count > 1)
            and all(_allowed(key, x) for x in numbers)
        )
        if not good:
            raise CaptureError(
                f"{path}: {key} = {value}, allowed: {count} finite number(s); correct the lens "
                "file",
                field=key,
                value=value,
            )
    if set(raw) != set(KEYS):
        unknown = sorted(set(raw) - set(KEYS))
        raise CaptureError(f"{path}: unknown key {unknown[0]}; remove it", field=unknown[0])
    return Lens(
        int(raw["columns"]),
        int(raw["rows"]),
        tuple(raw["focal"]),
        tuple(raw["center"]),
        tuple(raw["distortion"]),
    )


def _allowed(key: str, value: object) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return False
    return key in ("distortion", "center") or value > 0


class Dewarp:
    """Turns photographs of a lens into those of the scene's pinhole; maps are made once.

    Arguments:
        lens: of the camera.
        scene: whose camera is wanted.
    """

    def __init__(self, lens: Lens, scene: Scene) -> None:
        """Make the maps."""
        import cv2

        self._lens = lens
        size = (scene.camera.columns, scene.camera.rows)
        self._maps = cv2.fisheye.initUndistortRectifyMap(
            lens.matrix,
            np.array(lens.distortion),
            np.eye(3),
            intrinsics(scene, *size),
            size,
            cv2.CV_32FC1,
        )

    def __call__(self, photo: Array) -> Array:
        """Return ``photo`` ``(row, column, 3)`` as the scene's camera would have taken it.

        Raises:
            CaptureError: a photograph of another size.
        """
        import cv2

        if photo.shape[:2] != (self._lens.rows, self._lens.columns):
            raise CaptureError(
                f"the photograph has {photo.shape[1]} x {photo.shape[0]} pixels, allowed: "
                f"{self._lens.columns} x {self._lens.rows} as the lens file says; capture at that "
                "size",
                field="capture",
                value=photo.shape[:2],
            )
        return np.asarray(
            cv2.remap(photo, *self._maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
        )
