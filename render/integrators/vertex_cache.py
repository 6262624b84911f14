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

import drjit as dr
import mitsuba as mi
import numpy as np

from render.integrators.resampling import LightProxies, PackedProxies
from render.integrators.subpaths import LightVertex, LightVertices
from render.paths.records import PackedRecords, stacked
from render.sampling.streams import Numbers

SHARED_PATHS = 48
"""Light subpaths that each camera subpath of plain Monte Carlo is connected to."""
NEIGHBOR_WINDOW = 512
"""Places before and behind the camera vertex's own that are near it."""
NEIGHBOR_SCALE = 4.0
"""How many of them are about as likely as the very nearest one."""
MORTON_BITS = 16
"""Bits per axis of a place on the curve; the rest of a key is the group."""


class LaneGroups:
    """Groups of lanes, those of equal number modulo ``groups``, which stay independent.

    Within a group film positions are stratified, and each camera subpath is connected to ``paths``
    of the group's light subpaths.
    """

    def __init__(self, lanes: int, groups: int, paths: int) -> None:
        """Upload the numbers: literal ones would be compiled into the kernels."""
        self.lanes, self.groups, self.paths = (mi.UInt32(n) for n in (lanes, groups, paths))
        dr.make_opaque(self.lanes, self.groups, self.paths)
        self.count = groups
        self.lane = dr.arange(mi.UInt32, lanes)

    def film_positions(self, numbers: Numbers, height: int) -> mi.Point2f:
        """Return uniform film positions in [0, 1)^2 for uniform numbers.

        ``height`` is the number of pixel rows, along which the strata run.
        """
        x, y = numbers[:2]
        place, members = self.lane // self.groups, self.members(self.lane)
        # (place + x) / members of all rows; whole rows are counted in integers, which keeps all
        # bits of x.
        before = place * height // members
        part = (mi.Float(place * height - before * members) + x * height) / mi.Float(members)
        row = dr.floor(part)
        return mi.Point2f(part - row, (mi.Float(before) + row + y) / height)

    def partner(self, lane: mi.UInt32, k: mi.UInt32) -> mi.UInt32:
        """Return the lane whose light subpath is the ``k``-th partner of ``lane``; itself first.

        Partners are as far apart as can be, so that errors of pixels close by differ.
        """
        members = self.members(lane)
        step = dr.maximum(members // self.paths, 1)
        place = (lane // self.groups + k * step) % members
        return place * self.groups + lane % self.groups

    def members(self, lane: mi.UInt32) -> mi.UInt32:
        """Return how many lanes the group of ``lane`` has."""
        return (self.lanes - lane % self.groups + self.groups - 1) // self.groups


class LightVertexCache:
    """All kept light vertices: one slot of all lanes after the other."""

    def __init__(self, light: LightVertices, groups: LaneGroups) -> None:
        lanes = dr.width(groups.lane)
        self.groups, self.slots = groups, len(light.kept)
        vertices: LightVertex = stacked(light.kept, lanes)
        self.represented: mi.Float = stacked(light.represented, lanes)
        self.proxies = LightProxies.of(vertices, self.represented)
        self.packed = PackedRecords(vertices)

    def index(self, number: mi.UInt32) -> mi.UInt32:
        """Return where the ``number``-th vertex of each lane's partners is."""
        k = number // self.slots
        lane = self.groups.partner(self.groups.lane, k)
        return (number - k * self.slots) * self.groups.lanes + lane

    def vertex(self, index: mi.UInt32, active: mi.Bool) -> LightVertex:
        """Return the vertices at ``index``."""
        found: LightVertex = self.packed.gather(index, active)
        return found


class MortonNeighbors:
    """The light vertices of each group in Morton order, around a point per lane."""

    def __init__(self, proxies: LightProxies, groups: LaneGroups, p: mi.Point3f) -> None:
        """Order the vertices ``proxies`` and find the places of the points ``p``."""
        lanes = dr.width(groups.lane)
        # With NumPy: each small kernel would take LLVM longer than the work in it.
        there = np.array(proxies.power) > 0
        number = np.arange(len(there), dtype=np.uint64)
        group = number % np.uint64(lanes) % np.uint64(groups.count)
        points = np.stack([np.array(c)[there] for c in proxies.p])
        low, high = points.min(axis=1, initial=np.inf), points.max(axis=1, initial=-np.inf)
        size = (high - low).max()
        self.low = mi.Point3f(low if there.any() else 0.0)
        self.scale = mi.Float((1 << MORTON_BITS) / size if size > 0 else 1.0)
        dr.make_opaque(self.low, self.scale)
        keys = np.array(self._keys(proxies.p, mi.UInt64(group)))
        # Vertices without light come behind all groups.
        starts = np.arange(groups.count + 1, dtype=np.uint64) << np.uint64(3 * MORTON_BITS)
        keys[~there] = starts[-1]
        order = np.argsort(keys).astype(np.uint32)
        keys = keys[order]
        rank = np.empty(len(order), dtype=np.int32)
        rank[order] = np.arange(len(order), dtype=np.int32)
        self.order, self.rank, sorted_keys = mi.UInt32(order), mi.Int32(rank), mi.UInt64(keys)
        self.proxies = PackedProxies(dr.gather(LightProxies, proxies, self.order))
        mine = groups.lane % groups.groups
        limits = mi.Int32(np.searchsorted(keys, starts).astype(np.int32))
        self.first, self.last = (
            dr.gather(mi.Int32, limits, mine),
            dr.gather(mi.Int32, limits, mine + 1),
        )
        key = self._keys(p, mi.UInt64(mine))
        self.place = mi.Int32(
            dr.binary_search(0, len(keys), lambda i: dr.gather(mi.UInt64, sorted_keys, i) < key)
        )
        # Light subpaths of the group for each that a camera subpath looks at.
        self.ratio = mi.Float(groups.members(groups.lane)) / mi.Float(groups.paths)
        dr.eval(self.first, self.last, self.place, self.ratio)

    def _keys(self, p: mi.Point3f, group: mi.UInt64) -> mi.UInt64:
        scaled = dr.clip((p - self.low) * self.scale, 0.0, float((1 << MORTON_BITS) - 1))
        key = group << (3 * MORTON_BITS)
        for axis in range(3):
            key |= _interleaved(mi.UInt64(scaled[axis])) << axis
        return key

    def sample(self, number: mi.Float, count: int) -> tuple[LightProxies, mi.Int32, mi.Float]:
        """Return a vertex near each lane's point, one of ``count``, and its place in the order.

        The last result is how many of the vertices that ``holds`` leaves out it represents, 0 where
        there is none.
        """
        signed = 2.0 * number - 1.0
        log_range = np.log1p(NEIGHBOR_WINDOW / NEIGHBOR_SCALE)
        offset = mi.Int32(NEIGHBOR_SCALE * (dr.exp(dr.abs(signed) * log_range) - 1.0))
        place = self.place + dr.select(signed < 0, -offset, offset)
        valid = (place >= self.first) & (place < self.last) & (offset < NEIGHBOR_WINDOW)
        probability = dr.log(1.0 + dr.rcp(mi.Float(offset) + NEIGHBOR_SCALE)) / log_range
        probability = dr.select(offset > 0, 0.5 * probability, probability)
        represented = dr.select(valid, dr.rcp(self.ratio * probability * count), 0.0)
        return self.proxies.gather(mi.UInt32(place), valid), place, represented

    def holds(self, index: mi.UInt32) -> mi.Bool:
        """Return whether ``sample`` can find the vertex with that ``index``."""
        return dr.abs(dr.gather(mi.Int32, self.rank, index) - self.place) < NEIGHBOR_WINDOW

    def index(self, place: mi.Int32) -> mi.UInt32:
        """Return the index of the vertex at ``place``."""
        return dr.gather(mi.UInt32, self.order, mi.UInt32(place))


def _interleaved(x: mi.UInt64) -> mi.UInt64:
    """Return ``x`` of 16 bits with two zero bits between any two."""
    for shift, mask in (
        (16, 0x0000FF0000FF), (8, 0x00F00F00F00F), (4, 0x0C30C30C30C3), (2, 0x249249249249)
    ):  # fmt: skip
        x = (x | (x << shift)) & mi.UInt64(mask)
    return x
