"""Camera rays as Dr.Jit arrays; the same pinhole as ``render.geometry.visibility``."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from render.geometry import camera_origin
from render.scene import Scene


def pixel_rays(scene: Scene, column: Any, row: Any, columns: int, rows: int) -> tuple[Any, Any]:
    """Return origins (mm) and unit directions through continuous image positions in pixels."""
    half_height = float(np.tan(scene.camera.field_of_view / 2))
    half_width = half_height * columns / rows
    u = 1 - 2 * column / columns
    v = 1 - 2 * row / rows
    d = dr.normalize(mi.Vector3f(u * half_width, v * half_height, 1.0))
    origin = mi.Point3f(*camera_origin(scene).tolist())
    return origin + dr.zeros(mi.Point3f, dr.width(d)), d
