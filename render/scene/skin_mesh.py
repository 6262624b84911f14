"""The upper side of a closed mesh as the height of a skin: samples on a grid, smooth between them.

Samples lie on a grid of `GRID` by `GRID` places over the body's outline; between them heights are
those of the bicubic spline through them, whose slopes are continuous as those of a cast gel are.
What is finer than a cell of that grid, facets of the mesh among it, is rounded.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import GetJsonSchemaHandler, ValidationInfo, model_validator
from pydantic_core import CoreSchema

from render.arrays import Array
from render.mesh_file import read_mesh, unit_of_outline
from render.mesh_units import UNITS, Unit
from render.scene.quantities import Part, quantity_form

if TYPE_CHECKING:
    import trimesh

GRID = 65
"""Samples along each side of the outline."""
OUTLINE = 0.05
"""Length (mm) by which a body's outline may miss the pad's."""
INNER, LEVEL, PLANE = 0.4, 0.1, 0.01
"""Upper and lower side are looked at on triangles nearer to the middle than this part of the sides,
that are this far from upright (cosine); they are plane to so many mm."""
ZOOMS, PART = 12, 8.0
"""How often the highest place is looked for anew, within that many times smaller a square."""
FORM = '{ file = "...", source = "..." }'


class MeshHeights(Part):
    """Heights of a body's upper side, from its file.

    ``sides`` are those of its outline along x and y in mm, ``heights`` in mm over its crown, rows
    along y. Its outline has the origin in the middle; its height over z = 0 does not matter, as the
    crown lies at ``pad.thickness``. ``body_height`` is that of the whole body in mm, ``unit`` that
    of its file where it is another: they change no light, and people may compare them.
    """

    sides: tuple[float, ...]
    heights: tuple[float, ...]
    body_height: float | None = None
    unit: str | None = None

    @model_validator(mode="before")
    @classmethod
    def _from_file(cls, raw: Any, info: ValidationInfo) -> Any:
        body, unit = closed_body(named_file(raw, info), info)
        samples, (low, high) = MeshSamples.of(body), body.bounds[:, 2]
        return {
            "body_height": round(float(high - low), 6),
            "unit": None if unit == "mm" else unit,
            "sides": tuple(samples.sides.tolist()),
            "heights": tuple(samples.heights.ravel().tolist()),
        }

    @classmethod
    def __get_pydantic_json_schema__(
        cls, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        """Return the JSON schema of the form that the file must have."""
        path = {"type": "string", "description": "STL, PLY or OBJ, relative to the scene file."}
        return quantity_form({"file": path}, "")

    @property
    def sentence(self) -> str:
        """The mesh in words."""
        side, other = self.sides
        read = f", its file read in {self.unit}" if self.unit else ""
        return (
            f"mesh of {side:g} x {other:g} mm, down to {-min(self.heights):.3g} mm under its crown"
            f"{read}"
        )

    @property
    def crown(self) -> float:
        """Height of the crown over the highest sample, mm."""
        return _crown(self.sides, self.heights)

    def rise(self, x: Array, y: Array) -> Array:
        """Return the height (mm) at ``x, y`` (mm) over that of the crown; outside, the border's."""
        spline = spline_through(self.sides, self.heights)
        x, y = self._inside(x, y)
        return np.asarray(spline.ev(y, x) - self.crown)

    def slope(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Return the derivatives of `rise` along x and y, on its outline and within."""
        spline = spline_through(self.sides, self.heights)
        x, y = self._inside(x, y)
        return np.asarray(spline.ev(y, x, dy=1)), np.asarray(spline.ev(y, x, dx=1))

    def _inside(self, x: Array, y: Array) -> tuple[Array, Array]:
        half_x, half_y = 0.5 * self.sides[0], 0.5 * self.sides[1]
        x, y = np.broadcast_arrays(x, y)
        return np.clip(x, -half_x, half_x), np.clip(y, -half_y, half_y)


def named_file(raw: Any, info: ValidationInfo) -> Path:
    """Return the path that a file and its source name in a scene file."""
    keys = set(raw) if isinstance(raw, dict) else set()
    if keys != {"file", "source"} or not all(isinstance(raw[key], str) for key in keys):
        raise ValueError(f"must be {FORM}")
    folder: Path = (info.context or {}).get("folder", Path())
    return folder / str(raw["file"])


@lru_cache(maxsize=64)
def spline_through(sides: tuple[float, ...], samples: tuple[float, ...]) -> Any:
    """Return the bicubic spline over y and x through samples on the grid of a body."""
    from scipy.interpolate import RectBivariateSpline  # a robot that checks needs none

    x, y = (np.linspace(-0.5, 0.5, GRID) * side for side in sides)
    return RectBivariateSpline(y, x, np.reshape(samples, (GRID, GRID)), s=0)


@lru_cache(maxsize=32)
def _crown(sides: tuple[float, ...], heights: tuple[float, ...]) -> float:
    """Return the greatest height of the spline."""
    spline, half = spline_through(sides, heights), 0.5 * np.array(sides)
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
    return crown


def closed_body(path: Path, info: ValidationInfo) -> tuple[trimesh.Trimesh, Unit]:
    """Return a closed mesh in mm, and the unit of its file: as it says, or as the pad is wide."""
    mesh, named = read_mesh(path)
    if not mesh.is_watertight:
        # Named parts of one file have corners of their own, as faces of other textures have.
        mesh.merge_vertices(merge_tex=True, merge_norm=True)
    pad = (info.context or {}).get("pad_sides")
    unit = named or unit_of_outline(mesh.extents[:2], pad)
    if unit != "mm":
        mesh.vertices = np.asarray(mesh.vertices) * UNITS[unit]
    if not mesh.is_watertight:
        _, count = np.unique(np.sort(mesh.edges, axis=1), axis=0, return_counts=True)
        raise ValueError(
            f"{path.name} leaks: {int((count != 2).sum())} of its edges do not join two triangles, "
            "allowed: a closed body"
        )
    if not mesh.is_winding_consistent:
        raise ValueError(
            f"{path.name} has triangles that face in beside others that face out, allowed: all out"
        )
    if mesh.volume <= 0.0:
        raise ValueError(
            f"{path.name} is inverted: its volume is {mesh.volume:.4g} mm^3, allowed: triangles "
            "that all face outwards"
        )
    _refuse_upside_down(mesh, path.name)
    low, high = np.asarray(mesh.bounds)
    aside = 0.5 * np.abs(low + high)[:2].max()
    if aside > OUTLINE:
        raise ValueError(
            f"{path.name} has its middle {aside:.3g} mm beside the origin, allowed: x = y = 0 in "
            f"the middle of the pad, to {OUTLINE:g} mm"
        )
    return mesh, unit


def _refuse_upside_down(mesh: trimesh.Trimesh, name: str) -> None:
    """Refuse a body that is plane on top and curved below: its skin looks down."""
    low, high = np.asarray(mesh.bounds)
    away = np.abs(mesh.triangles_center - 0.5 * (low + high))[:, :2]
    inner = (away < INNER * (high - low)[:2]).all(axis=1)
    up = mesh.face_normals[:, 2]
    top, bottom = (
        np.ptp(mesh.triangles[inner & side][..., 2]) if (inner & side).any() else 0.0
        for side in (up > LEVEL, up < -LEVEL)
    )
    if top <= PLANE < bottom:
        raise ValueError(
            f"{name} lies upside down: it is plane on top and curved by {bottom:.3g} mm below, "
            "allowed: the skin on top (+z); turn the body by 180 deg about x or y"
        )


@dataclass(frozen=True, eq=False)
class MeshSamples:
    """The upper side of a body on the grid: rows along y.

    Arguments:
        sides: ``(2,)`` of its outline, mm.
        places: ``(row, column, 2)`` x and y, mm.
        heights: ``(row, column)`` over the highest, mm; that is at ``highest``.
        triangle: ``(row, column)`` number of the one that is met from above.
        weights: ``(row, column, 2)`` of its second and third corner there.
    """

    sides: Array
    places: Array
    heights: Array
    highest: float
    triangle: NDArray[np.int64]
    weights: Array

    @classmethod
    def of(cls, mesh: trimesh.Trimesh) -> MeshSamples:
        """Return the samples of a closed body.

        Sides and heights are rounded to nanometers, so that they are the same on every machine.
        """
        triangles = np.asarray(mesh.triangles, dtype=np.float64)
        low, high = np.asarray(mesh.bounds)
        sides = (high - low)[:2]
        middle = 0.5 * (low + high)[:2]
        # A little within: places on the outline itself may miss its triangles by rounding.
        x, y = (
            np.linspace(-0.5, 0.5, GRID) * s * (1 - 1e-9) + m
            for s, m in zip(sides, middle, strict=True)
        )
        top = np.full((GRID, GRID), -np.inf)
        met, weights = np.zeros((GRID, GRID), dtype=np.int64), np.zeros((GRID, GRID, 2))
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
            above = inside & (height > top[j, i])
            top[j, i] = np.where(above, height, top[j, i])
            met[j, i] = np.where(above, k, met[j, i])
            weights[j, i] = np.where(above[..., None], np.stack([u, v], axis=-1), weights[j, i])
        missing = ~np.isfinite(top)
        if missing.any():
            row, column = np.argwhere(missing)[0]
            raise ValueError(
                f"the upper side ends within the outline, at x = {x[column]:.3g}, y = {y[row]:.3g} "
                "mm, allowed: the rectangle of the pad, all of it"
            )
        return cls(
            sides=np.round(sides, 6),
            places=np.stack(np.meshgrid(x, y), axis=-1),
            heights=np.round(top - top.max(), 6),
            highest=float(top.max()),
            triangle=met,
            weights=weights,
        )
