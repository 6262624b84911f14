"""Lanes of the film sampler that are sampled together: strata, and shared light subpaths."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from render.arrays import Array

# Light subpaths that each camera subpath of plain Monte Carlo is joined to.
SHARED = 48


class Ensemble:
    """Groups of lanes, those of equal number modulo ``groups``, which stay independent.

    Within a group film positions are stratified, and each camera subpath is joined to ``paths`` of
    the group's light subpaths.
    """

    def __init__(self, lanes: int, groups: int, paths: int, density: Array | None = None) -> None:
        """Upload the numbers: literal ones would be compiled into the kernels.

        Film positions follow ``density`` ``(row, column)`` of cells, all positive, that fill the
        film; without one they are uniform.
        """
        self.lanes, self.groups, self.paths = (mi.UInt32(n) for n in (lanes, groups, paths))
        dr.make_opaque(self.lanes, self.groups, self.paths)
        self.count = groups
        self.lane: Any = dr.arange(mi.UInt32, lanes)
        self.edges: Any = None
        self.cells = (0, 0) if density is None else density.shape
        if density is not None:
            edges = np.append(0.0, np.cumsum(density / density.sum()))
            edges[-1] = 1.0
            self.edges = mi.Float(edges.astype(np.float32))

    def placed(self, numbers: Any, height: int) -> tuple[Any, Any]:
        """Return film positions in [0, 1)^2, and 1 / their density, for three uniform numbers.

        ``height`` is the number of pixel rows, along which strata of a uniform density run.
        """
        x, y, z = numbers[:3]
        place, members = self.lane // self.groups, self.members(self.lane)
        if self.edges is None:
            # (place + x) / members of all rows; whole rows are counted in integers, which keeps
            # all bits of x.
            before = place * height // members
            part = (mi.Float(place * height - before * members) + x * height) / mi.Float(members)
            row = dr.floor(part)
            return mi.Point2f(part - row, (mi.Float(before) + row + y) / height), mi.Float(1.0)
        rows, columns = self.cells
        at = dr.minimum((mi.Float(place) + x) / mi.Float(members), 1.0 - 2.0**-24)
        search: Any = dr.binary_search
        cell = search(
            0, rows * columns - 1,
            lambda i: dr.gather(mi.Float, self.edges, mi.UInt32(i) + 1) <= at,
        )  # fmt: skip
        share = dr.gather(mi.Float, self.edges, cell + 1) - dr.gather(mi.Float, self.edges, cell)
        row = cell // columns
        column = mi.Float(cell - row * columns)
        position = mi.Point2f((column + z) / columns, (mi.Float(row) + y) / rows)
        return position, 1.0 / (share * (rows * columns))

    def partner(self, lane: Any, k: Any) -> Any:
        """Return the lane whose light subpath is the ``k``-th partner of ``lane``; itself first.

        Partners are as far apart as can be, so that errors of pixels close by differ.
        """
        members = self.members(lane)
        step = dr.maximum(members // self.paths, 1)
        place = (lane // self.groups + k * step) % members
        return place * self.groups + lane % self.groups

    def members(self, lane: Any) -> Any:
        """Return how many lanes the group of ``lane`` has."""
        return (self.lanes - lane % self.groups + self.groups - 1) // self.groups
