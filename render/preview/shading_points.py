"""The points of the pad at which light is evaluated: facets, sites, and patches of its faces.

Positions are flat pad coordinates and normals local ones, so they are the same at every bend.
A skin that is not flat is one of the flat pad: then all of them are those of the world.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from render.arrays import Array
from render.geometry import Imprint, SkinChart, pyramids
from render.scene import EDGES, OUTWARD, Scene

MAX_PATCH_SIDE, MIN_PATCH_FRACTION = 0.625, 1 / 16
"""Longest side of a patch in thicknesses of the pad, unless that is less than this part of its
longest side."""
EDGE_PATCH_ROWS = 3
"""Patches of edges from the lower face to the coating."""


@dataclass(frozen=True)
class ShadingPoints:
    """Points in the order facets, sites, coating patches, edge patches.

    Arguments:
        position, normal: ``(point, 3)`` mm and unit vectors into the pad.
        ground, below: those of the untouched skin where a facet is pressed; elsewhere a point's
            own.
        size: ``(point, 2)`` mm, extent of a patch along its edge (or x) and upwards (or y); 0 for
            facets and sites.
        sites, facets: their numbers; ``columns`` and ``rows`` of the coating patches.
        edge: ``(edge patch,)`` number in `EDGES` of the edge that each lies on.
    """

    position: Array
    normal: Array
    ground: Array
    below: Array
    size: Array
    sites: int
    facets: int
    columns: int
    rows: int
    edge: NDArray[np.int64]

    @property
    def first_patch(self) -> int:
        """Index of the first coating patch."""
        return self.sites * (self.facets + 1)

    @property
    def first_edge(self) -> int:
        """Index of the first edge patch."""
        return self.first_patch + self.columns * self.rows


def shading_points(scene: Scene, imprint: Imprint | None = None) -> ShadingPoints:
    """Return the points of a scene that ``imprint`` (default: the pyramids) presses.

    Edges have patches where a diffuser or white paint sends light back to all sides.
    """
    pad, imprint = scene.pad, imprint or pyramids(scene)
    sites = imprint.center
    longest = max(MAX_PATCH_SIDE * pad.thickness, MIN_PATCH_FRACTION * max(pad.width, pad.length))
    columns, rows = (int(np.ceil(side / longest)) for side in (pad.width, pad.length))
    x = pad.width * ((np.arange(columns) + 0.5) / columns - 0.5)
    y = pad.length * ((np.arange(rows) + 0.5) / rows - 0.5)
    grid_y, grid_x = (grid.ravel() for grid in np.meshgrid(y, x, indexing="ij"))
    faces = len(imprint.normal)
    facet_position, facet_normal = (
        np.concatenate([part @ turn.T for turn in imprint.turn])
        for part in (imprint.middle, imprint.normal)
    )
    facet_position += np.repeat(sites, faces, axis=0)
    chart = SkinChart(scene, 0.0)
    coating = chart.flat(np.stack([grid_x, grid_y], axis=-1))
    inward, coating_normal = -imprint.turn[..., 2], -chart.frames(coating[:, :2])[..., 2]
    coating_size = np.tile([pad.width / columns, pad.length / rows], (len(coating), 1))
    edge_position, edge_normal, edge_size, edge = _edge_patches(scene, x, y)
    untouched = [sites, coating, edge_position], [inward, coating_normal, edge_normal]
    point_size = np.zeros((len(sites) * (faces + 1), 2))
    return ShadingPoints(
        np.concatenate([facet_position, *untouched[0]]),
        np.concatenate([facet_normal, *untouched[1]]),
        np.concatenate([np.repeat(sites, faces, axis=0), *untouched[0]]),
        np.concatenate([np.repeat(inward, faces, axis=0), *untouched[1]]),
        np.concatenate([point_size, coating_size, edge_size]),
        len(sites),
        faces,
        columns,
        rows,
        edge,
    )


def _edge_patches(
    scene: Scene, x: Array, y: Array
) -> tuple[Array, Array, Array, NDArray[np.int64]]:
    """Return position, normal, size and edge of the patches on white and on milky edges."""
    pad = scene.pad
    part = (np.arange(EDGE_PATCH_ROWS) + 0.5) / EDGE_PATCH_ROWS
    position, normal, size, edge = (
        [np.zeros((0, 3))],
        [np.zeros((0, 3))],
        [np.zeros((0, 2))],
        [np.zeros(0, dtype=np.int64)],
    )
    for number, name in enumerate(EDGES):
        if name not in scene.diffuser_edges and not scene.finish(name).white:
            continue
        outward = OUTWARD[number]
        along, length = (x, pad.width) if outward[1] else (y, pad.length)
        up, grid = (axis.ravel() for axis in np.meshgrid(part, along, indexing="ij"))
        fixed = np.full_like(grid, outward[:2] @ [pad.width, pad.length] / 2)
        place = np.stack((grid, fixed) if outward[1] else (fixed, grid), axis=-1)
        height = SkinChart(scene, 0.0).height(place)
        position.append(np.concatenate([place, (height * up)[:, None]], axis=-1))
        normal.append(np.tile(-outward, (len(grid), 1)))
        wide = np.full(len(grid), length / len(along))
        size.append(np.stack([wide, height / EDGE_PATCH_ROWS], axis=-1))
        edge.append(np.full(len(grid), number))
    return (
        np.concatenate(position),
        np.concatenate(normal),
        np.concatenate(size),
        np.concatenate(edge),
    )
