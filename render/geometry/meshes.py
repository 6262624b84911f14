"""The pad as triangle meshes for one bend, touched by the pyramids at all sites or untouched.

The flat block is cut by x- and y-lines into columns of full height: a grid of clear pad and
diffuser, around which is air. All faces are quads between shared grid vertices, except the squares
around pressed sites, which are remeshed. So all meshes share their border vertices bit for bit,
and their union is one closed surface. Meshes are in the world frame, in mm.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from render.arrays import Array
from render.geometry.bending import bend_points
from render.geometry.chart import SkinChart
from render.geometry.height_map import HeightMap
from render.geometry.indenter import Imprint, imprint_depth
from render.geometry.layout import declared_sites, facets, pyramid
from render.scene import FACES, OUTWARD, Scene

if TYPE_CHECKING:
    import trimesh

Index = NDArray[np.int64]

MAX_ROW_STEP = 0.5
"""Longest step (mm) between y-lines of a bent pad: chords of an arc of 19 mm sag by 2 um."""

MAX_SAG, MAX_SKIN_STEP = 5e-4, 0.25
"""Longest sag (mm) of chords of a skin that is not flat, and step between its lines at most."""

IMPRINT_STEP = 0.08
"""Longest step (mm) of the grid of a coating that a body is pressed into."""


class ColumnMaterial(IntEnum):
    """What a column of the grid is filled with."""

    AIR = 0
    DIFFUSER = 1
    CLEAR = 2


@dataclass(frozen=True)
class PadGrid:
    """Grid lines (mm, flat frame) and the material of every column.

    ``x (columns + 1,)``, ``y (rows + 1,)``, ``z (2,)``; ``material (rows, columns)``. Vertex
    ``(i, j, k)`` on lines ``x[i], y[j], z[k]`` has the number ``(k * len(y) + j) * len(x) + i``.
    """

    x: Array
    y: Array
    z: Array
    material: Index

    @cached_property
    def points(self) -> Array:
        """Flat positions ``(vertex, 3)`` of all grid vertices, mm."""
        z, y, x = np.meshgrid(self.z, self.y, self.x, indexing="ij")
        return np.stack([x.ravel(), y.ravel(), z.ravel()], axis=-1)

    def vertex(self, i: Index, j: Index, k: Index | int) -> Index:
        """Return the numbers of the vertices on lines ``x[i], y[j], z[k]``."""
        return np.asarray((k * len(self.y) + j) * len(self.x) + i)

    def level(self, columns: NDArray[np.bool_], k: int) -> Index:
        """Return the triangles ``(face, 3)`` of columns at ``z[k]``; normals point to -z."""
        j, i = np.nonzero(columns)
        corners = [(i, j), (i, j + 1), (i + 1, j + 1), (i + 1, j)]
        return _split([self.vertex(a, b, k) for a, b in corners])

    def walls(self, inside: ColumnMaterial, outside: ColumnMaterial) -> Index:
        """Return the upright triangles whose normals point from one material into another."""
        ring = np.pad(self.material, 1, constant_values=ColumnMaterial.AIR)
        faces = []
        for first, second, turned in ((inside, outside, False), (outside, inside, True)):
            j, i = np.nonzero((ring[1:-1, :-1] == first) & (ring[1:-1, 1:] == second))
            across = [
                self.vertex(i, j, 0),
                self.vertex(i, j + 1, 0),
                self.vertex(i, j + 1, 1),
                self.vertex(i, j, 1),
            ]
            j, i = np.nonzero((ring[:-1, 1:-1] == first) & (ring[1:, 1:-1] == second))
            along = [
                self.vertex(i, j, 0),
                self.vertex(i, j, 1),
                self.vertex(i + 1, j, 1),
                self.vertex(i + 1, j, 0),
            ]
            quads = np.concatenate([_split(across), _split(along)])
            faces.append(quads[:, ::-1] if turned else quads)
        return np.concatenate(faces)


def pad_grid(scene: Scene, bend: float, indented: bool) -> PadGrid:
    """Return the grid of the block: lines at its edges, around sites, and along the arc."""
    half_width, half_length = scene.pad.width / 2, scene.pad.length / 2
    x, y = [-half_width, half_width], [-half_length, half_length]
    if indented:
        sites, half = declared_sites(scene), scene.indenter.clearance
        x += [*(sites[:, 0] - half), *(sites[:, 0] + half)]
        y += [*(sites[:, 1] - half), *(sites[:, 1] + half)]
    if scene.diffuser:
        # Lines of edges without a layer are there already.
        low, high = scene.box.low, scene.box.high
        x += [low[0], high[0]]
        y += [low[1], high[1]]
    x_lines, y_lines = _merged(x), _merged(y)
    if scene.skin is not None:
        x_lines, y_lines = (_refined(lines, _skin_step(scene)) for lines in (x_lines, y_lines))
    elif bend != 0.0:
        y_lines = _refined(y_lines, MAX_ROW_STEP)
    centre_x, centre_y = 0.5 * (x_lines[1:] + x_lines[:-1]), 0.5 * (y_lines[1:] + y_lines[:-1])
    clear = (np.abs(centre_y) < half_length)[:, None] & (np.abs(centre_x) < half_width)[None, :]
    material = np.where(clear, ColumnMaterial.CLEAR, ColumnMaterial.DIFFUSER)
    return PadGrid(x_lines, y_lines, np.array([0.0, scene.pad.thickness]), material)


def _flat_points(scene: Scene, grid: PadGrid) -> Array:
    """Return the flat positions of a grid's vertices, its upper ones on the skin."""
    points = grid.points.copy()
    upper = points[:, 2] > 0.0
    points[upper] = SkinChart(scene, 0.0).flat(points[upper, :2])
    return points


def _merged(values: Sequence[float]) -> Array:
    """Sort lines and merge those that differ by rounding only."""
    lines = np.sort(np.asarray(values, dtype=np.float64))
    return np.asarray(lines[np.concatenate([[True], np.diff(lines) > 1e-9])])


def _skin_step(scene: Scene) -> float:
    """Return the step (mm) between lines at which chords of the skin sag by `MAX_SAG` at most."""
    assert scene.skin is not None
    pad, skin = scene.pad, scene.skin
    x, y = skin.grid(pad.width, pad.length)
    change = [
        np.abs(np.diff(part, axis=axis)).max() / (side / (len(x) - 1))
        for part, axis, side in zip(skin.slope(x, y), (1, 0), (pad.width, pad.length), strict=True)
    ]
    return min(MAX_SKIN_STEP, float(np.sqrt(8 * MAX_SAG / max(*change, 1e-9))))


def _refined(lines: Array, step: float) -> Array:
    pieces = [
        np.linspace(a, b, int(np.ceil((b - a) / step)) + 1)[:-1]
        for a, b in itertools.pairwise(lines)
    ]
    return np.concatenate([*pieces, lines[-1:]])


def _split(corners: list[Index]) -> Index:
    """Split quads, given as four vertex arrays in order, into triangles of the same winding."""
    a, b, c, d = corners
    return np.concatenate([np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)])


@dataclass(frozen=True)
class PadMeshes:
    """The faces of the silicone block, sorted by what lies on their two sides.

    Arguments:
        coating: the painted far side; normals point into the pad, at the camera.
        outer_clear: faces between air and clear silicone; normals point into the air.
        outer_diffuser: faces between air and diffuser, normals into the air; None without one.
        interface: faces between diffuser and clear pad, normals into the clear pad, or None.
        clear_side, diffuser_side: ``(triangle,)`` of both outer meshes, the number of the face of
            `render.scene.FACES` that it is part of; their number on the far side of the diffuser.
    """

    coating: trimesh.Trimesh
    outer_clear: trimesh.Trimesh
    outer_diffuser: trimesh.Trimesh | None
    interface: trimesh.Trimesh | None
    clear_side: Index
    diffuser_side: Index
    window: WindowMeshes | None = None


@dataclass(frozen=True)
class WindowMeshes:
    """The faces of the window under a flat pad.

    Arguments:
        bond: faces between pad and window; normals point into the window.
        outer: faces between air and window; normals point into the air.
        side: ``(triangle,)`` of the outer mesh, the number of the face that it is part of.
    """

    bond: trimesh.Trimesh
    outer: trimesh.Trimesh
    side: Index


def pad_meshes(scene: Scene, bend: float, indented: bool) -> PadMeshes:
    """Return the meshes of the pad at ``bend`` radians, pressed by the pyramids or untouched."""
    grid = pad_grid(scene, bend, indented)
    points = bend_points(scene, _flat_points(scene, grid), bend)
    clear = grid.material == ColumnMaterial.CLEAR
    if indented:
        corners = facets(scene, bend).corners
        # Per site: the apex, then the base polygon.
        pressed = np.concatenate([corners[:, :1, 0], corners[:, :, 1]], axis=1)
        flat_faces = grid.level(clear & ~_site_columns(scene, grid), 1)
        sites = [_site_faces(scene, grid, site) for site in range(scene.sites.count)]
        faces = np.concatenate([flat_faces, *sites])
        coating = _mesh(np.concatenate([points, pressed.reshape(-1, 3)]), faces)
    else:
        coating = _mesh(points, grid.level(clear, 1))
    outer_clear = grid.walls(ColumnMaterial.CLEAR, ColumnMaterial.AIR)
    if scene.window is None:
        outer_clear = np.concatenate([grid.level(clear, 0), outer_clear])
    outer_diffuser = interface = None
    outer_layer = np.zeros((0, 3), dtype=np.int64)
    if scene.diffuser:
        layer = grid.material == ColumnMaterial.DIFFUSER
        top = grid.level(layer, 1)[:, ::-1]
        sides = grid.walls(ColumnMaterial.DIFFUSER, ColumnMaterial.AIR)
        outer_layer = np.concatenate([grid.level(layer, 0), top, sides])
        outer_diffuser = _mesh(points, outer_layer)
        interface = _mesh(points, grid.walls(ColumnMaterial.DIFFUSER, ColumnMaterial.CLEAR))
    return PadMeshes(
        coating,
        _mesh(points, outer_clear),
        outer_diffuser,
        interface,
        _sides(scene, grid.points[outer_clear]),
        _sides(scene, grid.points[outer_layer]),
        _window(scene, grid) if scene.window else None,
    )


def _window(scene: Scene, grid: PadGrid) -> WindowMeshes:
    """Return the window under the flat pad of ``grid``, with which it shares its upper vertices."""
    below = PadGrid(grid.x, grid.y, np.array([scene.box.low[2], 0.0]), grid.material)
    clear = grid.material == ColumnMaterial.CLEAR
    outer = np.concatenate(
        [below.level(clear, 0), below.walls(ColumnMaterial.CLEAR, ColumnMaterial.AIR)]
    )
    bond = _mesh(below.points, below.level(clear, 1))
    return WindowMeshes(bond, _mesh(below.points, outer), _sides(scene, below.points[outer]))


def _sides(scene: Scene, corners: Array) -> Index:
    """Return the number in `FACES` of triangles ``(triangle, corner, 3)`` of the flat block."""
    low, high = scene.box.low @ OUTWARD.T, scene.box.high @ OUTWARD.T
    level = np.maximum(low, high)
    on = np.isclose(corners @ OUTWARD.T, level, rtol=0.0, atol=1e-9).all(axis=1)
    return np.asarray(np.where(on.any(axis=1), on.argmax(axis=1), len(FACES)))


def mesh_part(mesh: trimesh.Trimesh, chosen: np.ndarray) -> trimesh.Trimesh:
    """Return the ``chosen`` triangles (a mask) of a mesh, bit for bit where they were."""
    return _mesh(np.asarray(mesh.vertices), np.asarray(mesh.faces)[chosen])


def turned_inside_out(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Return the mesh with its normals to the other side."""
    return _mesh(np.asarray(mesh.vertices), np.asarray(mesh.faces)[:, ::-1])


def imprinted_coating(scene: Scene, bend: float, imprint: Imprint | HeightMap) -> trimesh.Trimesh:
    """Return the coating with a body pressed in, as a fine grid; normals point into the pad.

    Its border lies in that of the untouched coating (``pad_meshes``), at the corners exactly.
    """
    x, y = (
        np.linspace(-0.5 * side, 0.5 * side, int(np.ceil(side / IMPRINT_STEP)) + 1)
        for side in (scene.pad.width, scene.pad.length)
    )
    grid = PadGrid(x, y, np.array([scene.pad.thickness]), np.zeros((0, 0), dtype=np.int64))
    points = _flat_points(scene, grid)
    inner = (np.abs(points[:, 0]) < x[-1]) & (np.abs(points[:, 1]) < y[-1])
    points[inner, 2] -= imprint_depth(imprint, *points[inner].T)
    faces = grid.level(np.ones((len(y) - 1, len(x) - 1), dtype=bool), 0)
    return _mesh(bend_points(scene, points, bend), faces)


def _mesh(points: Array, faces: Index) -> trimesh.Trimesh:
    # A robot's check comes by here, and has no trimesh.
    import trimesh

    used, renumbered = np.unique(faces, return_inverse=True)
    return trimesh.Trimesh(points[used], renumbered.reshape(faces.shape), process=False)


def _site_columns(scene: Scene, grid: PadGrid) -> np.ndarray:
    """Mark the columns ``(rows, columns)`` that lie in the square cell of a site."""
    half = scene.indenter.clearance
    sites = declared_sites(scene)
    near_x = np.abs(0.5 * (grid.x[1:] + grid.x[:-1]) - sites[:, :1]) < half
    near_y = np.abs(0.5 * (grid.y[1:] + grid.y[:-1]) - sites[:, 1:2]) < half
    return np.asarray((near_y[:, :, None] & near_x[:, None, :]).any(axis=0))


def _site_faces(scene: Scene, grid: PadGrid, site: int) -> Index:
    """Return the triangles of one site's cell: the ring, then the facets.

    The ring joins the cell's border, which lies on the coating, to the base of the pyramid.
    """
    faces_of_pyramid = scene.indenter.faces
    apex = len(grid.points) + site * (faces_of_pyramid + 1)
    base = apex + 1 + np.arange(faces_of_pyramid)
    center = declared_sites(scene)[site]
    border = _border(grid, center, scene.indenter.clearance)
    outline = grid.points[border] - center
    # Azimuths run from +y to +x, the other way round than turns.
    polygon = _azimuth(pyramid(scene)[:, 1]) - scene.sites.turns[site]
    joined = _triangulated_ring(_azimuth(outline), polygon % (2 * np.pi))
    ring = np.concatenate([border, base])[joined]
    sides = np.stack([np.full_like(base, apex), base, np.roll(base, -1)], axis=-1)
    return np.concatenate([ring, sides])


def _border(grid: PadGrid, center: Array, half: float) -> Index:
    """Return the coating vertices on the border of a site's cell, in order of azimuth."""
    i0, i1 = (int(np.abs(grid.x - center[0] - d).argmin()) for d in (-half, half))
    j0, j1 = (int(np.abs(grid.y - center[1] - d).argmin()) for d in (-half, half))
    i, j = np.meshgrid(np.arange(i0, i1 + 1), np.arange(j0, j1 + 1))
    edge = (i == i0) | (i == i1) | (j == j0) | (j == j1)
    border = grid.vertex(i[edge], j[edge], 1)
    return border[np.argsort(_azimuth(grid.points[border] - center))]


def _azimuth(offset: Array) -> Array:
    """Return the azimuth in [0, 2 pi) of points about the site; 0 is the tip, pi/2 is +x."""
    return np.asarray(np.arctan2(offset[..., 0], offset[..., 1]) % (2 * np.pi))


def _triangulated_ring(outer: Array, inner: Array) -> Index:
    """Triangulate the ring between two convex loops, given by ascending (cyclic) azimuths.

    Walking around, each edge of either loop is joined to the other loop's current vertex; edges
    come in the order of their middle azimuths, so every edge meets a vertex that faces it.
    Vertices of ``inner`` are numbered after those of ``outer``; normals point to -z.
    """
    middle, start = [], []
    for azimuth in (outer, inner):
        gap = (np.roll(azimuth, -1) - azimuth) % (2 * np.pi)
        between = (azimuth + 0.5 * gap) % (2 * np.pi)
        order = np.argsort(between)
        middle.append(between[order])
        start.append(order)
    m, k = len(outer), len(inner)
    facing_inner = start[1][np.searchsorted(middle[1], middle[0], side="right") % k]
    facing_outer = start[0][np.searchsorted(middle[0], middle[1], side="left") % m]
    on_outer = np.stack([m + facing_inner, start[0], (start[0] + 1) % m], axis=-1)
    on_inner = np.stack([facing_outer, m + (start[1] + 1) % k, m + start[1]], axis=-1)
    return np.concatenate([on_outer, on_inner])
