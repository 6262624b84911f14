"""The lens of a real camera: a fisheye, or a pinhole with radial and tangential terms.

Read from our own TOML, from the YAML of OpenCV, or from ROS's camera_info (``hw/README.md``).
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hw.errors import CaptureError
from render.arrays import Array
from render.files import parse_toml, read_text

FISHEYE, PINHOLE = "fisheye", "pinhole"
MODELS = {
    "fisheye": FISHEYE,
    "equidistant": FISHEYE,
    "pinhole": PINHOLE,
    "plumb_bob": PINHOLE,
    "rational_polynomial": PINHOLE,
}
"""What files call a lens."""
COEFFICIENTS = {FISHEYE: (4,), PINHOLE: (4, 5, 8, 12, 14)}
"""Numbers of coefficients that OpenCV knows for each."""
KEYS = {
    "columns": ("columns", "image_width", "width"),
    "rows": ("rows", "image_height", "height"),
    "matrix": ("camera_matrix", "K", "k"),
    "distortion": ("distortion", "distortion_coefficients", "D", "d"),
    "model": ("model", "distortion_model"),
}
"""What files call each part."""
OWN_KEYS = {"columns", "rows", "model", "focal", "center", "distortion"}
FOLD_STEPS = np.linspace(0.0, math.tan(math.radians(89.0)), 4000)
"""Tangents of angles from the axis at which a pinhole's radius is looked at."""


@dataclass(frozen=True)
class Lens:
    """A lens as `cv2.calibrateCamera` or `cv2.fisheye.calibrate` finds it.

    Arguments:
        columns, rows: size of its photographs.
        focal, center: pixels, along x and y.
        distortion: k1 to k4 of a fisheye, theta_d = theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6
            + k4 theta^8), or OpenCV's k1, k2, p1, p2, k3, ... of a pinhole.
        model: ``fisheye`` or ``pinhole``.
    """

    columns: int
    rows: int
    focal: tuple[float, float]
    center: tuple[float, float]
    distortion: tuple[float, ...]
    model: str = FISHEYE

    def positions(self, directions: Array) -> Array:
        """Return where directions ``(..., 3)`` (right, down, ahead) appear, ``(..., 2)`` pixels.

        Positions count from the middle of the first pixel, as in OpenCV. They are -1e6 where the
        model does not hold: behind a pinhole, and where its radius no longer grows.
        """
        if self.model == PINHOLE:
            return self._pinhole(directions)
        side = np.hypot(directions[..., 0], directions[..., 1])
        theta = np.arctan2(side, directions[..., 2])
        powers = theta[..., None] ** [2, 4, 6, 8]
        bent = theta * (1.0 + powers @ np.array(self.distortion))
        scale = (bent / np.where(side > 0, side, 1.0))[..., None]
        return np.asarray(self.center + self.focal * (scale * directions[..., :2]))

    def _pinhole(self, directions: Array) -> Array:
        ahead = directions[..., 2] > 1e-6
        tangents = directions[..., :2] / np.where(ahead, directions[..., 2], 1.0)[..., None]
        # Beyond a certain angle polynomials fold back, and show the same place twice.
        ring = np.stack([FOLD_STEPS, 0 * FOLD_STEPS], axis=-1)
        radius = self._projected(ring)[:, 0] - self._projected(-ring)[:, 0]
        fallen = np.flatnonzero(np.diff(radius) <= 0)
        most = FOLD_STEPS[fallen[0]] if len(fallen) else np.inf
        known = ahead & (np.hypot(tangents[..., 0], tangents[..., 1]) <= most)
        places = self._projected(np.where(known[..., None], tangents, 0.0).reshape(-1, 2))
        return np.where(known[..., None], places.reshape(tangents.shape), -1e6)

    def _projected(self, tangents: Array) -> Array:
        """Return pixels ``(n, 2)`` of tangents ``(n, 2)`` from the axis, as OpenCV has them."""
        import cv2

        (fx, fy), (cx, cy) = self.focal, self.center
        matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        points = np.concatenate([tangents, np.ones((len(tangents), 1))], axis=1)
        found, _ = cv2.projectPoints(
            points, np.zeros(3), np.zeros(3), matrix, np.array(self.distortion)
        )
        return np.asarray(found, dtype=np.float64).reshape(-1, 2)


def load_lens(path: Path) -> Lens:
    """Return the lens in a TOML file, or in the YAML of OpenCV or of ROS's camera_info.

    Raises:
        CaptureError: unreadable, or a key is missing, unknown or out of range.
    """
    try:
        text = read_text(path)
        if path.suffix.lower() in (".yaml", ".yml"):
            return _lens(_from_yaml(text))
        raw = parse_toml(text)
        if unknown := sorted(set(raw) - OWN_KEYS):
            raise ValueError(
                f"{unknown[0]} is no key of a lens, allowed: {', '.join(sorted(OWN_KEYS))}"
            )
        return _lens({"model": FISHEYE, **raw})
    except (ValueError, RecursionError) as error:
        raise CaptureError(
            f"{path} cannot be read as a lens: {error}; give its TOML, or the YAML of OpenCV or of "
            "ROS's camera_info",
            field="lens",
        ) from None


def _from_yaml(text: str) -> Mapping[str, Any]:
    """Return the content of a YAML file, OpenCV's matrices as mappings."""
    import yaml

    loader: Any = type("Loader", (yaml.SafeLoader,), {})
    loader.add_constructor(
        "tag:yaml.org,2002:opencv-matrix", lambda one, node: one.construct_mapping(node, True)
    )
    # OpenCV's first line is no directive of YAML.
    body = text.partition("\n")[2] if text.startswith("%YAML:") else text
    try:
        # What records a topic goes on with the next message.
        raw = next(yaml.load_all(body, loader), None)
    except yaml.YAMLError as error:
        raise ValueError(" ".join(str(error).split())) from None
    if not isinstance(raw, dict):
        raise ValueError("it holds no keys")
    if raw.get("fisheye_model"):
        raw["model"] = FISHEYE
    return raw


def _lens(raw: Mapping[str, Any]) -> Lens:
    """Return the lens that a file's content says; ValueError says what is wrong."""
    found = {
        part: next((raw[key] for key in keys if key in raw), None) for part, keys in KEYS.items()
    }
    columns, rows = (_size(part, found[part]) for part in ("columns", "rows"))
    if "focal" in raw or "center" in raw:
        focal, center = (_numbers(part, raw.get(part), (2,)) for part in ("focal", "center"))
    else:
        fx, skew, cx, _, fy, cy, *_ = _numbers("camera_matrix", found["matrix"], (9,))
        if skew:
            raise ValueError(f"camera_matrix has a skew of {skew:g}, allowed: 0")
        focal, center = (fx, fy), (cx, cy)
    if min(focal) <= 0:
        raise ValueError(f"the focal length is {min(focal):g}, allowed: above 0")
    told = found["model"]
    every = tuple(sorted({count for counts in COEFFICIENTS.values() for count in counts}))
    if told is None:
        if len(distortion := _numbers("distortion", found["distortion"], every)) == 4:
            raise ValueError(
                "four coefficients may be a fisheye's or a pinhole's: say which with "
                "distortion_model: equidistant, or plumb_bob"
            )
        told = "pinhole"
    if told not in MODELS:
        raise ValueError(f"its model is {told!r}, allowed: {', '.join(MODELS)}")
    model = MODELS[told]
    distortion = _numbers("distortion", found["distortion"], COEFFICIENTS[model])
    return Lens(columns, rows, (focal[0], focal[1]), (center[0], center[1]), distortion, model)


def _shown(value: Any) -> str:
    """Return a file's value as a sentence shows it."""
    return "missing" if value is None else json.dumps(value, default=str)[:60]


def _size(part: str, value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 < value <= 65536:
        raise ValueError(f"{part} is {_shown(value)}, allowed: 1 to 65536 pixels")
    return value


def _numbers(part: str, value: Any, counts: tuple[int, ...]) -> tuple[float, ...]:
    """Return finite numbers from a list, or from the data of a matrix."""
    value = value.get("data") if isinstance(value, dict) else value
    found = tuple(_floats(value)) if isinstance(value, list) else ()
    if len(found) not in counts or not all(map(math.isfinite, found)):
        said = " or ".join(map(str, counts))
        raise ValueError(f"{part} is {_shown(value)}, allowed: a list of {said} finite numbers")
    return found


def _floats(values: list[Any]) -> Iterator[float]:
    for value in values:
        try:
            # YAML takes 1e-3, without a point, for text.
            yield math.nan if isinstance(value, bool) else float(value)
        except (TypeError, ValueError, OverflowError):
            yield math.nan
