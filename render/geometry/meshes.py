"""The pad as triangle meshes for one bend, touched by the pyramids at all sites or untouched.

Every mesh is in the world frame, in mm. The meshes share their border vertices bit for bit, so
their union is one closed surface.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh

from render.arrays import Array
from render.geometry.bending import bend_points
from render.geometry.layout import facets, flat_sites, pyramid
from render.geometry.pad_grid import ColumnMaterial, Index, PadGrid, pad_grid, site_half_width
from render.scene import Scene


@dataclass(frozen=True)
class PadMeshes:
    """The faces of the silicone block, sorted by what lies on their two sides.

    Arguments:
        coating: the painted far side; normals point into the pad, at the camera.
        coating_face_site, coating_face_facet: ``(face,)`` int64, -1 where no pyramid touches.
        outer_clear: faces between air and clear silicone; normals point into the air.
        outer_diffuser: faces between air and diffuser, normals into the air; None without one.
        interface: faces between diffuser and clear pad, normals into the clear pad, or None.
    """

    coating: trimesh.Trimesh
    coating_face_site: Index
    coating_face_facet: Index
    outer_clear: trimesh.Trimesh
    outer_diffuser: trimesh.Trimesh | None
    interface: trimesh.Trimesh | None


def pad_meshes(scene: Scene, bend: float, indented: bool) -> PadMeshes:
    """Return the meshes of the pad at ``bend`` radians, pressed by the pyramids or untouched."""
    grid = pad_grid(scene, bend, indented)
    points = bend_points(scene, grid.points, bend)
    clear = grid.material == ColumnMaterial.CLEAR
    if indented:
        corners = facets(scene, bend).corners
        # Per site: the apex, then the base polygon.
        pressed = np.concatenate([corners[:, :1, 0], corners[:, :, 1]], axis=1)
        flat_faces = grid.level(clear & ~_site_columns(scene, grid), 1)
        parts = [_site_faces(scene, grid, site) for site in range(scene.sites.count)]
        faces = np.concatenate([flat_faces, *(part[0] for part in parts)])
        face_facet = np.concatenate([np.full(len(flat_faces), -1), *(part[1] for part in parts)])
        owner = np.repeat(np.arange(len(parts)), [len(part[1]) for part in parts])
        face_site = np.concatenate([np.full(len(flat_faces), -1), owner])
        face_site[face_facet < 0] = -1
        coating = _mesh(np.concatenate([points, pressed.reshape(-1, 3)]), faces)
    else:
        faces = grid.level(clear, 1)
        face_site = face_facet = np.full(len(faces), -1)
        coating = _mesh(points, faces)
    outer_clear = [grid.level(clear, 0), grid.walls(ColumnMaterial.CLEAR, ColumnMaterial.AIR)]
    outer_diffuser = interface = None
    if scene.diffuser:
        layer = grid.material == ColumnMaterial.DIFFUSER
        top = grid.level(layer, 1)[:, ::-1]
        sides = grid.walls(ColumnMaterial.DIFFUSER, ColumnMaterial.AIR)
        outer_diffuser = _mesh(points, np.concatenate([grid.level(layer, 0), top, sides]))
        interface = _mesh(points, grid.walls(ColumnMaterial.DIFFUSER, ColumnMaterial.CLEAR))
    return PadMeshes(
        coating,
        face_site,
        face_facet,
        _mesh(points, np.concatenate(outer_clear)),
        outer_diffuser,
        interface,
    )


def _mesh(points: Array, faces: Index) -> trimesh.Trimesh:
    used, renumbered = np.unique(faces, return_inverse=True)
    return trimesh.Trimesh(points[used], renumbered.reshape(faces.shape), process=False)


def _site_columns(scene: Scene, grid: PadGrid) -> np.ndarray:
    """Mark the columns ``(rows, columns)`` that lie in the square cell of a site."""
    half = site_half_width(scene)
    sites = flat_sites(scene)
    near_x = np.abs(0.5 * (grid.x[1:] + grid.x[:-1]) - sites[:, :1]) < half
    near_y = np.abs(0.5 * (grid.y[1:] + grid.y[:-1]) - sites[:, 1:2]) < half
    return np.asarray((near_y[:, :, None] & near_x[:, None, :]).any(axis=0))


def _site_faces(scene: Scene, grid: PadGrid, site: int) -> tuple[Index, Index]:
    """Return the triangles of one site's cell and the facet of each (-1 on the ring).

    The ring joins the cell's border, which lies on the coating, to the base of the pyramid.
    """
    faces_of_pyramid = scene.indenter.faces
    apex = len(grid.points) + site * (faces_of_pyramid + 1)
    base = apex + 1 + np.arange(faces_of_pyramid)
    center = flat_sites(scene)[site]
    border = _border(grid, center, site_half_width(scene))
    outline = grid.points[border] - center
    polygon = pyramid(scene)[:, 1]
    joined = _triangulated_ring(_azimuth(outline), _azimuth(polygon))
    ring = np.concatenate([border, base])[joined]
    sides = np.stack([np.full_like(base, apex), base, np.roll(base, -1)], axis=-1)
    facet = np.concatenate([np.full(len(ring), -1), np.arange(faces_of_pyramid)])
    return np.concatenate([ring, sides]), facet


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
