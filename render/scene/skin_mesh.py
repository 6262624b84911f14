"""The upper side of a closed mesh as the height of a skin: samples on a grid, smooth between them.

Samples lie on a grid of `GRID` by `GRID` places over the body's outline; between them heights are
those of the bicubic spline through them, whose slopes are continuous as those of a cast gel are.
What is finer than a cell of that grid, facets of the mesh among it, is rounded.
"""

from __future__ import annotations

import math
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import GetJsonSchemaHandler, ValidationInfo, model_validator
from pydantic_core import CoreSchema

from render.arrays import Array
from render.mesh_file import read_mesh
from render.scene.quantities import Part, quantity_form

GRID = 65
"""Samples along each side of the outline."""
OUTLINE = 0.05
"""Length (mm) by which a body's outline may miss the pad's."""
ZOOMS, PART = 12, 8.0
"""How often the highest place is looked for anew, within that many times smaller a square."""
FORM = '{ file = "...", source = "..." }'


class MeshHeights(Part):
    """Heights of a body's upper side, from its file.

    ``sides`` are those of its outline along x and y in mm, ``heights`` in mm over its crown, rows
    along y. Its outline has the origin in the middle; its height over z = 0 does not matter.
    """

    sides: tuple[float, ...]
    heights: tuple[float, ...]

    @model_validator(mode="before")
    @classmethod
    def _from_file(cls, raw: Any, info: ValidationInfo) -> Any:
        keys = set(raw) if isinstance(raw, dict) else set()
        if keys != {"file", "source"} or not all(isinstance(raw[key], str) for key in keys):
            raise ValueError(f"must be {FORM}")
        path = (info.context or {}).get("folder", Path()) / raw["file"]
        sides, heights = _sampled(*_closed_body(path))
        return {"sides": tuple(sides.tolist()), "heights": tuple(heights.ravel().tolist())}

    @classmethod
    def __get_pydantic_json_schema__(
        cls, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        """Return the JSON schema of the form that the file must have."""
        path = {"type": "string", "description": "STL, PLY or OBJ in mm, relative to the scene."}
        return quantity_form({"file": path}, "")

    @property
    def sentence(self) -> str:
        """The mesh in words."""
        side, other = self.sides
        return (
            f"mesh of {side:g} x {other:g} mm, down to {-min(self.heights):.3g} mm under its crown"
        )

    def rise(self, x: Array, y: Array) -> Array:
        """Return the height (mm) at ``x, y`` (mm) over that of the crown; outside, the border's."""
        spline, crown = _spline(self.sides, self.heights)
        x, y = self._inside(x, y)
        return np.asarray(spline.ev(y, x) - crown)

    def slope(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Return the derivatives of `rise` along x and y, on its outline and within."""
        spline, _ = _spline(self.sides, self.heights)
        x, y = self._inside(x, y)
        return np.asarray(spline.ev(y, x, dy=1)), np.asarray(spline.ev(y, x, dx=1))

    def _inside(self, x: Array, y: Array) -> tuple[Array, Array]:
        half_x, half_y = 0.5 * self.sides[0], 0.5 * self.sides[1]
        x, y = np.broadcast_arrays(x, y)
        return np.clip(x, -half_x, half_x), np.clip(y, -half_y, half_y)


@lru_cache(maxsize=8)
def _spline(sides: tuple[float, ...], heights: tuple[float, ...]) -> tuple[Any, float]:
    """Return the spline over y and x, and its greatest height."""
    from scipy.interpolate import RectBivariateSpline  # a robot that checks needs none

    x, y = (np.linspace(-0.5, 0.5, GRID) * side for side in sides)
    spline = RectBivariateSpline(y, x, np.reshape(heights, (GRID, GRID)), s=0)
    half = 0.5 * np.array(sides)
    middle, reach, crown = np.zeros(2), half, -math.inf
    for _ in range(ZOOMS):
        near = [
            np.linspace(-1.0, 1.0, 4 * GRID) * r + m for r, m in zip(reach, middle, strict=True)
        ]
        x, y = (np.clip(axis, -h, h) for axis, h in zip(near, half, strict=True))
        found = spline(*map(np.unique, (y, x)))
        row, column = np.unravel_index(int(found.argmax()), found.shape)
        middle = np.array([np.unique(x)[column], np.unique(y)[row]])
        crown, reach = max(crown, float(found.max())), reach / PART
    return spline, crown


def _closed_body(path: Path) -> tuple[Array, Array]:
    """Return the triangles ``(n, 3, 3)`` and bounds ``(2, 3)`` of a closed mesh, mm."""
    mesh = read_mesh(path)
    if not mesh.is_watertight:
        _, count = np.unique(np.sort(mesh.edges, axis=1), axis=0, return_counts=True)
        raise ValueError(
            f"{path.name} leaks: {int((count != 2).sum())} of its edges do not join two triangles, "
            "allowed: a closed body"
        )
    if not mesh.is_winding_consistent or mesh.volume <= 0.0:
        raise ValueError(
            f"{path.name} is inverted: its volume is {mesh.volume:.4g} mm^3, allowed: triangles "
            "that all face outwards"
        )
    low, high = np.asarray(mesh.bounds)
    aside = 0.5 * np.abs(low + high)[:2].max()
    if aside > OUTLINE:
        raise ValueError(
            f"{path.name} has its middle {aside:.3g} mm beside the origin, allowed: x = y = 0 in "
            f"the middle of the pad, to {OUTLINE:g} mm"
        )
    return np.asarray(mesh.triangles, dtype=np.float64), np.asarray(mesh.bounds)


def _sampled(triangles: Array, bounds: Array) -> tuple[Array, Array]:
    """Return the sides ``(2,)`` of the outline, and the heights ``(row, column)`` over the highest.

    Rounded to nanometers, so that they are the same on every machine.
    """
    low, high = bounds
    sides = (high - low)[:2]
    middle = 0.5 * (low + high)[:2]
    # A little within: places on the outline itself may miss its triangles by rounding.
    x, y = (
        np.linspace(-0.5, 0.5, GRID) * s * (1 - 1e-9) + m
        for s, m in zip(sides, middle, strict=True)
    )
    top = np.full((GRID, GRID), -np.inf)
    (ax, ay), (bx, by), (cx, cy) = np.moveaxis(triangles[..., :2], 0, -1)
    area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
    least, most = triangles[..., :2].min(axis=1) - 1e-9, triangles[..., :2].max(axis=1) + 1e-9
    starts, ends = (
        np.stack([np.searchsorted(x, edge[:, 0]), np.searchsorted(y, edge[:, 1])], axis=-1)
        for edge in (least, most)
    )
    # Those that face up, and have places over them.
    for k in np.flatnonzero((area > 0.0) & (starts < ends).all(axis=1)):
        a, b, c = triangles[k]
        i, j = slice(starts[k, 0], ends[k, 0]), slice(starts[k, 1], ends[k, 1])
        dx, dy = x[None, i] - a[0], y[j, None] - a[1]
        u = (dx * (c[1] - a[1]) - (c[0] - a[0]) * dy) / area[k]
        v = ((b[0] - a[0]) * dy - dx * (b[1] - a[1])) / area[k]
        inside = (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1 + 1e-9)
        height = a[2] + u * (b[2] - a[2]) + v * (c[2] - a[2])
        top[j, i] = np.where(inside, np.maximum(top[j, i], height), top[j, i])
    missing = ~np.isfinite(top)
    if missing.any():
        row, column = np.argwhere(missing)[0]
        raise ValueError(
            f"the upper side ends within the outline, at x = {x[column]:.3g}, y = {y[row]:.3g} mm, "
            "allowed: the rectangle of the pad, all of it"
        )
    return np.round(sides, 6), np.round(top - top.max(), 6)
