"""The structured grid of the silicone block: one set of lines, so that all its faces conform.

The block is cut by x- and y-lines into columns of full height. Every column is clear pad or
diffuser; whatever lies outside is air. All faces are quads between shared grid vertices, so
surfaces built from them meet without T-junctions.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from render.arrays import Array
from render.geometry.layout import flat_sites
from render.scene import Scene

Index = NDArray[np.int64]

MAX_ROW_STEP = 0.5
"""Longest step (mm) between y-lines of a bent pad: chords of an arc of 19 mm sag by 2 um."""


class ColumnMaterial(IntEnum):
    """What a column of the grid is filled with."""

    AIR = 0
    DIFFUSER = 1
    CLEAR = 2


def site_half_width(scene: Scene) -> float:
    """Return half the side (mm) of the square cell that is remeshed around a pyramid.

    It is the clearance that scene validation guarantees: cells never overlap or leave the pad.
    """
    return 1.5 * scene.indenter.radius


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
        sites, half = flat_sites(scene), site_half_width(scene)
        x += [*(sites[:, 0] - half), *(sites[:, 0] + half)]
        y += [*(sites[:, 1] - half), *(sites[:, 1] + half)]
    if scene.diffuser:
        margin = scene.diffuser.thickness
        x += [-half_width - margin, half_width + margin]
        y += [half_length + margin]
    x_lines, y_lines = _merged(x), _merged(y)
    if bend != 0.0:
        y_lines = _refined(y_lines)
    centre_x, centre_y = 0.5 * (x_lines[1:] + x_lines[:-1]), 0.5 * (y_lines[1:] + y_lines[:-1])
    clear = (np.abs(centre_y) < half_length)[:, None] & (np.abs(centre_x) < half_width)[None, :]
    material = np.where(clear, ColumnMaterial.CLEAR, ColumnMaterial.DIFFUSER)
    return PadGrid(x_lines, y_lines, np.array([0.0, scene.pad.thickness]), material)


def _merged(values: Sequence[float]) -> Array:
    """Sort lines and merge those that differ by rounding only."""
    lines = np.sort(np.asarray(values, dtype=np.float64))
    return np.asarray(lines[np.concatenate([[True], np.diff(lines) > 1e-9])])


def _refined(lines: Array) -> Array:
    pieces = [
        np.linspace(a, b, int(np.ceil((b - a) / MAX_ROW_STEP)) + 1)[:-1]
        for a, b in itertools.pairwise(lines)
    ]
    return np.concatenate([*pieces, lines[-1:]])


def _split(corners: list[Index]) -> Index:
    """Split quads, given as four vertex arrays in order, into triangles of the same winding."""
    a, b, c, d = corners
    return np.concatenate([np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)])
