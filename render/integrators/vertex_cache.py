"""The light vertex cache of the film sampler: who shares light vertices, and which lie near.

Connections to a cache of light vertices (Davidovic et al. 2014, "Progressive light transport
simulation on the GPU"). Lanes form groups that stay independent; within a group each camera subpath
looks at the vertices of many light subpaths, and at some close to it.

Of light vertices that are drawn evenly, few lie where light is rare, and there the nearest ones
matter. So those near the camera vertex's own place in Morton order are drawn separately: a place
``r`` away with a probability nearly proportional to ``1 / (r + NEIGHBOR_SCALE)``, so that all
scales are drawn alike often, whatever the size of the scene.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from render.integrators.resampling import PROXY_WORDS, LightProxies, PackedProxies
from render.integrators.subpaths import SubpathVertex
from render.paths.records import DrawnRecords
from render.sampling.streams import Numbers

SHARED_PATHS = 48
"""Light subpaths that each camera subpath of plain Monte Carlo is connected to."""
NEIGHBOR_WINDOW = 512
"""Places before and behind the camera vertex's own that are near it."""
NEIGHBOR_SCALE = 4.0
"""How many of them are about as likely as the very nearest one."""
MORTON_BITS = 16
"""Bits per axis of a place on the curve; the rest of a key is the group."""
MORTON_MAX = float((1 << MORTON_BITS) - 1)


class LaneGroups:
    """Groups of lanes, those of equal number modulo ``groups``, which stay independent.

    Within a group film positions are stratified, and each camera subpath is connected to ``paths``
    of the group's light subpaths.
    """

    def __init__(self, lanes: int, groups: int, paths: int, rows: int = 1) -> None:
        """Upload the numbers: literal ones would be compiled into the kernels.

        ``rows`` is the number of pixel rows, along which the strata run.
        """
        # With NumPy: divisions of integers are slow, and for LLVM as well.
        lane = np.arange(lanes)
        place, group = np.divmod(lane, groups)
        members = lanes // groups + (group < lanes % groups)
        # Within the smallest group, no partner comes twice.
        paths = min(paths, lanes // groups)
        self.lanes, self.groups, self.paths, self.rows = (
            dr.opaque(mi.UInt32, n) for n in (lanes, groups, paths, rows)
        )
        self.count, self.path_count = groups, paths
        self.lane = dr.arange(mi.UInt32, lanes)
        columns = (place, group, members, members // paths, *np.divmod(place * rows, members))
        # Gathered, not loaded: how the memory of NumPy is aligned would be compiled.
        self._table = mi.UInt32(np.concatenate(columns).astype(np.uint32))
        self.place, self.group, self.members, self.apart = (
            self._column(k, self.lane) for k in range(4)
        )

    def _column(self, k: int, lane: mi.UInt32) -> mi.UInt32:
        return dr.gather(mi.UInt32, self._table, lane + k * self.lanes)

    def film_positions(self, lane: mi.UInt32, numbers: Numbers) -> mi.Point2f:
        """Return uniform film positions in [0, 1)^2 of lanes, for uniform numbers."""
        x, y = numbers[:2]
        members, before, rest = (mi.Float(self._column(k, lane)) for k in (2, 4, 5))
        # (place + x) / members of all rows; whole rows are counted in integers, which keeps all
        # bits of x.
        part = (rest + x * self.rows) / members
        row = dr.floor(part)
        return mi.Point2f(part - row, (before + row + y) / self.rows)

    def partner(self, k: mi.UInt32) -> mi.UInt32:
        """Return the lanes whose light subpath is the ``k``-th partner of each; itself first.

        Partners are as far apart as can be, so that errors of pixels close by differ.
        """
        place = self.place + k * self.apart
        place -= dr.select(place < self.members, 0, self.members)
        return place * self.groups + self.group


class LightVertexCache:
    """All light vertices that are kept for connections: one slot of all lanes after the other."""

    def __init__(self, kept: DrawnRecords, slots: int, groups: LaneGroups) -> None:
        """Take ``slots`` vertices of each lane, which follow those of its camera subpath."""
        self.packed, self.groups, self.slots = kept.packed, groups, slots
        lanes = dr.width(groups.lane)
        number = dr.arange(mi.UInt32, slots * lanes)
        k = mi.UInt32(0)
        for j in range(1, slots):
            k += dr.select(number < j * groups.lanes, mi.UInt32(0), 1)
        self.row, self.represented = kept.drawn(number + groups.lanes - k * groups.lanes, k)
        vertices = kept.packed.gather(self.row, self.represented > 0)
        self.proxies = PackedProxies(LightProxies.of(vertices, self.represented))
        dr.eval(self.row, self.represented, self.proxies.rows)

    def index(self, number: mi.UInt32) -> mi.UInt32:
        """Return where the ``number``-th vertex of each lane's partners is."""
        k = number // self.slots
        return (number - k * self.slots) * self.groups.lanes + self.groups.partner(k)

    def drawn(self, index: mi.UInt32) -> tuple[mi.UInt32, mi.Float]:
        """Return where the records of the vertices at ``index`` are, and what they represent."""
        return dr.gather(mi.UInt32, self.row, index), dr.gather(mi.Float, self.represented, index)

    def vertex(self, row: mi.UInt32, active: mi.Bool) -> SubpathVertex:
        """Return the vertices whose records are at ``row``."""
        found: SubpathVertex = self.packed.gather(row, active)
        found.vertex.weight = mi.Float(1.0)
        return found


class MortonNeighbors:
    """The light vertices of each group in Morton order, around a point per lane."""

    def __init__(self, proxies: PackedProxies, groups: LaneGroups, p: mi.Point3f) -> None:
        """Order the vertices ``proxies`` and find the places of the points ``p``."""
        lanes = dr.width(groups.lane)
        # With NumPy: each small kernel would take LLVM longer than the work in it.
        rows = np.array(proxies.rows).reshape(-1, PROXY_WORDS)
        points, there = rows[:, :3].T, rows[:, 3] > 0
        group = np.arange(len(rows), dtype=np.uint64) % np.uint64(lanes) % np.uint64(groups.count)
        low = points[:, there].min(axis=1, initial=np.inf)
        size = (points[:, there].max(axis=1, initial=-np.inf) - low).max()
        low, scale = np.where(there.any(), low, 0.0), (1 << MORTON_BITS) / size if size > 0 else 1.0
        scaled = np.clip((points - low[:, None]) * np.float32(scale), 0.0, MORTON_MAX)
        keys = _interleaved([axis.astype(np.uint64) for axis in scaled])
        # Vertices without light come behind all groups.
        keys += np.where(there, group, np.uint64(groups.count)) << np.uint64(3 * MORTON_BITS)
        order = np.argsort(keys).astype(np.uint32)
        keys = keys[order]
        rank = np.empty(len(order), dtype=np.int32)
        rank[order] = np.arange(len(order), dtype=np.int32)
        self.order, self.rank, sorted_keys = mi.UInt32(order), mi.Int32(rank), mi.UInt64(keys)
        starts = np.arange(groups.count + 1, dtype=np.uint64) << np.uint64(3 * MORTON_BITS)
        limits = mi.Int32(np.searchsorted(keys, starts).astype(np.int32))
        self.first, self.last = (dr.gather(mi.Int32, limits, groups.group + k) for k in range(2))
        first_point, cells = mi.Point3f(low.astype(np.float32)), mi.Float(scale)
        dr.make_opaque(first_point, cells)
        scaled = dr.clip((p - first_point) * cells, 0.0, MORTON_MAX)
        key = _interleaved([mi.UInt64(axis) for axis in scaled])
        key += mi.UInt64(groups.group) << (3 * MORTON_BITS)
        self.place = _lower_bound(sorted_keys, key, self.first, self.last)
        # Light subpaths of the group for each that a camera subpath looks at.
        self.ratio = mi.Float(groups.members) / mi.Float(groups.paths)

    def sample(self, number: mi.Float, count: int) -> tuple[mi.UInt32, mi.Float]:
        """Return the index of a vertex near each lane's point, one of ``count``.

        The second result is how many of the vertices that ``holds`` leaves out it represents, 0
        where there is none.
        """
        signed = 2.0 * number - 1.0
        log_range = np.log1p(NEIGHBOR_WINDOW / NEIGHBOR_SCALE)
        offset = mi.Int32(NEIGHBOR_SCALE * (dr.exp(dr.abs(signed) * log_range) - 1.0))
        place = self.place + dr.select(signed < 0, -offset, offset)
        valid = (place >= self.first) & (place < self.last) & (offset < NEIGHBOR_WINDOW)
        probability = dr.log(1.0 + dr.rcp(mi.Float(offset) + NEIGHBOR_SCALE)) / log_range
        probability = dr.select(offset > 0, 0.5 * probability, probability)
        represented = dr.select(valid, dr.rcp(self.ratio * probability * count), 0.0)
        return dr.gather(mi.UInt32, self.order, mi.UInt32(place), valid), represented

    def holds(self, index: mi.UInt32) -> mi.Bool:
        """Return whether ``sample`` can find the vertex with that ``index``."""
        return dr.abs(dr.gather(mi.Int32, self.rank, index) - self.place) < NEIGHBOR_WINDOW


@dr.syntax
def _lower_bound(keys: mi.UInt64, key: mi.UInt64, first: mi.Int32, last: mi.Int32) -> mi.Int32:
    """Return the first place from ``first`` on, up to ``last``, where ``keys`` are not below."""
    first, last = mi.Int32(first), mi.Int32(last)
    while first < last:
        middle = (first + last) >> 1
        below = dr.gather(mi.UInt64, keys, mi.UInt32(middle)) < key
        first = dr.select(below, middle + 1, first)
        last = dr.select(below, last, middle)
    return first


def _interleaved(axes: list[Any]) -> Any:
    """Return the bits of three numbers of 16 bits in turns, of NumPy's arrays or of Dr.Jit's."""
    key: Any = 0
    for axis, x in enumerate(axes):
        for shift, mask in (
            (16, 0x0000FF0000FF), (8, 0x00F00F00F00F), (4, 0x0C30C30C30C3), (2, 0x249249249249)
        ):  # fmt: skip
            x = (x | (x << shift)) & mask
        key = key | (x << axis)
    return key
