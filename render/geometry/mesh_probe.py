"""A body from a mesh file, pressed in with its lower end first: its own shape, hollows included."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from render.arrays import Array
from render.compiled import compiled
from render.errors import SceneError
from render.geometry.chart import SkinChart
from render.geometry.height_map import HeightMap, map_lines
from render.geometry.indenter import place_body, skin_heights
from render.geometry.layout import declared_sites
from render.mesh_file import read_mesh, size_in_words, unit_of_body
from render.mesh_units import UNITS, Unit
from render.scene import Scene

FILE_DEPTH = 1.0
"""How far the body of a file is pressed in unless it is told, mm; at most a quarter of the pad."""


def body_of_file(
    scene: Scene,
    path: Path,
    depth: float | None = None,
    smoothing: float = 0.0,
    unit: Unit | None = None,
) -> HeightMap:
    """Return the skin with the body of a file (STL, PLY, OBJ) in the middle of the sites.

    The file's z points out of the skin there and its y to the tip. What counts is the lower side,
    as it is seen from below, and nothing else: where a body overhangs, its lowest part. So the file
    need not be a closed body; what it leaves open presses nothing, or what lies over it does.

    Arguments:
        scene: the sensor.
        path: of the mesh.
        depth: how far its lowest point is pressed in, mm; None is 1 mm, or a quarter of the pad, or
            the body's height if that is less.
        smoothing: see `HeightMap.smoothed`.
        unit: of the file; None is what it says, or else what fits the pad (`unit_of_body`).

    Raises:
        SceneError: the file is no body, in no unit that is known, or has no area seen from below,
            or the pad is too small or too thin for it.
    """
    triangles, about = _triangles(scene, path, unit)
    low, high = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    height = float(high[2] - low[2])
    if height <= 0.0:
        raise SceneError(f"{path} is flat, allowed: a body with a volume", field="press")
    if depth is None:
        depth = min(FILE_DEPTH, 0.25 * scene.pad.thickness, height)
    elif depth > height:
        raise SceneError(
            f"depth = {depth:g} mm of {path}, which is {height:.3g} mm high, allowed: up to that; "
            f"{about}",
            field="depth",
        )
    triangles = triangles - [*(0.5 * (low + high))[:2], low[2] + depth]
    sunk = _sunk(triangles)
    half = np.abs(sunk[:, :2]).max(axis=0)
    center = place_body(scene, str(path), half, depth, declared_sites(scene)[:, 1].mean())
    turn = SkinChart(scene, 0.0).frames(center[:2])
    x, y = map_lines(scene)
    lowest = np.full((len(y), len(x)), np.inf)
    # Heights over the body's center on the skin.
    _rasterize(triangles @ turn.T + [*center[:2], 0.0], x, y, lowest)
    untouched = skin_heights(scene, x, y) - center[2]
    if lowest.min() <= -center[2]:
        raise SceneError(
            f"depth = {depth:g} mm of {path} goes through the pad, which is {center[2]:.3g} mm "
            "thick there, allowed: less",
            field="depth",
        )
    body = HeightMap(np.maximum(untouched - lowest, 0.0), scene.pad.width, scene.pad.length, about)
    if body.deepest == 0.0:
        raise SceneError(
            f"{path} has no area seen from below, at places {max(body.step):.2g} mm apart, so it "
            f"presses nothing, allowed: a body that covers some of them; {about}",
            field="press",
        )
    return body.smoothed(smoothing)


def _triangles(scene: Scene, path: Path, unit: Unit | None) -> tuple[Array, str]:
    """Return the triangles ``(n, 3, 3)`` of a mesh file, mm, and how its size was found."""
    try:
        mesh, named = read_mesh(path)
    except ValueError as error:
        raise SceneError(str(error), field="press") from None
    extents, pad = mesh.extents, max(scene.pad.width, scene.pad.length)
    if not extents.max() > 0.0:
        raise SceneError(f"{path} is a point, allowed: a body with a volume", field="press")
    try:
        found = unit or named or unit_of_body(extents, pad)
    except ValueError as error:
        raise SceneError(f"{path} {error}", field="unit", option="--unit") from None
    why = "as given" if unit else "as it says" if named else "by its size: give unit for another"
    triangles = np.asarray(mesh.triangles, dtype=np.float64) * UNITS[found]
    return triangles, f"{path.name} is {size_in_words(extents, found, pad)}, {why}"


def _sunk(triangles: Array) -> Array:
    """Return corners ``(n, 3)`` of the part of a mesh that lies below z = 0."""
    first = triangles.reshape(-1, 3)
    second = np.roll(triangles, -1, axis=1).reshape(-1, 3)
    crossing = first[:, 2] * second[:, 2] < 0
    below, a, b = first[first[:, 2] <= 0], first[crossing], second[crossing]
    return np.concatenate([below, a + a[:, 2:] / (a[:, 2:] - b[:, 2:]) * (b - a)])


def _lowest(triangles: Any, x: Any, y: Any, lowest: Any) -> None:
    """Lower ``lowest`` ``(row, column)`` to the triangles above or below each place."""
    dx, dy = x[1] - x[0], y[1] - y[0]
    for k in range(len(triangles)):
        a, b, c = triangles[k, 0], triangles[k, 1], triangles[k, 2]
        area = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])
        if area == 0.0:  # upright: its rims belong to its neighbors
            continue
        i0 = max(math.ceil((min(a[0], b[0], c[0]) - x[0]) / dx - 1e-9), 0)
        i1 = min(math.floor((max(a[0], b[0], c[0]) - x[0]) / dx + 1e-9), len(x) - 1)
        j0 = max(math.ceil((min(a[1], b[1], c[1]) - y[0]) / dy - 1e-9), 0)
        j1 = min(math.floor((max(a[1], b[1], c[1]) - y[0]) / dy + 1e-9), len(y) - 1)
        for j in range(j0, j1 + 1):
            for i in range(i0, i1 + 1):
                u = ((x[i] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (y[j] - a[1])) / area
                v = ((b[0] - a[0]) * (y[j] - a[1]) - (x[i] - a[0]) * (b[1] - a[1])) / area
                if u >= -1e-9 and v >= -1e-9 and u + v <= 1 + 1e-9:
                    z = a[2] + u * (b[2] - a[2]) + v * (c[2] - a[2])
                    lowest[j, i] = min(lowest[j, i], z)


_rasterize = compiled(_lowest)
