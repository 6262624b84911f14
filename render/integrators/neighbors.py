"""Light vertices close to a camera vertex, found by their order along a space-filling curve.

Of light vertices that are drawn evenly, few lie where light is rare, and there the nearest ones
matter. So those near the camera vertex's own place in Morton order are drawn separately: a place
``r`` away with a probability nearly proportional to ``1 / (r + NEAREST)``, so that all scales are
drawn alike often, whatever the size of the scene.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from render.integrators.proxy_weights import Seen
from render.integrators.vertex_cache import Ensemble
from render.paths.lane_memory import taken

# Places before and behind the camera vertex's own that are near it, and how many of them are about
# as likely as the very nearest one.
WINDOW, NEAREST = 512, 4.0
# Bits per axis of a place on the curve; the rest of a key is the group.
BITS = 16


class Nearby:
    """The light vertices of each group of an ensemble in order, around a point per lane."""

    def __init__(self, seen: Seen, ensemble: Ensemble, p: Any) -> None:
        """Order the vertices ``seen`` and find the places of the points ``p``."""
        lanes = dr.width(ensemble.lane)
        lit = seen.power > 0
        there = np.array(lit)
        number = np.arange(len(there), dtype=np.uint64)
        group = number % np.uint64(lanes) % np.uint64(ensemble.count)
        low = np.array([dr.min(dr.select(lit, c, dr.inf))[0] for c in seen.p])
        high = np.array([dr.max(dr.select(lit, c, -dr.inf))[0] for c in seen.p])
        size = (high - low).max()
        self.low = mi.Point3f(low if there.any() else 0.0)
        self.scale = mi.Float((1 << BITS) / size if size > 0 else 1.0)
        dr.make_opaque(self.low, self.scale)
        keys = np.array(self._keys(seen.p, mi.UInt64(group)))
        # Vertices without light come behind all groups.
        starts = np.arange(ensemble.count + 1, dtype=np.uint64) << np.uint64(3 * BITS)
        keys[~there] = starts[-1]
        order = np.argsort(keys).astype(np.uint32)
        keys = keys[order]
        rank = np.empty(len(order), dtype=np.int32)
        rank[order] = np.arange(len(order), dtype=np.int32)
        self.order, self.rank, sorted_keys = mi.UInt32(order), mi.Int32(rank), mi.UInt64(keys)
        self.seen = taken(seen, self.order)
        mine = ensemble.lane % ensemble.groups
        limits = mi.Int32(np.searchsorted(keys, starts).astype(np.int32))
        self.first, self.last = (
            dr.gather(mi.Int32, limits, mine),
            dr.gather(mi.Int32, limits, mine + 1),
        )
        key = self._keys(p, mi.UInt64(mine))
        search: Any = dr.binary_search
        self.place = mi.Int32(
            search(0, len(keys), lambda i: dr.gather(mi.UInt64, sorted_keys, i) < key)
        )
        # Light subpaths of the group for each that a camera subpath looks at.
        self.ratio = mi.Float(ensemble.members(ensemble.lane)) / mi.Float(ensemble.paths)
        dr.eval(self.seen, self.first, self.last, self.place, self.ratio)

    def _keys(self, p: Any, group: Any) -> Any:
        scaled = dr.clip((p - self.low) * self.scale, 0.0, float((1 << BITS) - 1))
        key = group << (3 * BITS)
        for axis in range(3):
            key |= _spread(mi.UInt64(scaled[axis])) << axis
        return key

    def drawn(self, number: Any, count: int) -> tuple[Seen, Any, Any]:
        """Return a vertex near each lane's point, one of ``count``, and its place.

        The last result is how many of the vertices that ``holds`` leaves out it stands for, 0 where
        there is none.
        """
        signed = 2.0 * number - 1.0
        reach = np.log1p(WINDOW / NEAREST)
        offset = mi.Int32(NEAREST * (dr.exp(dr.abs(signed) * reach) - 1.0))
        place = self.place + dr.select(signed < 0, -offset, offset)
        valid = (place >= self.first) & (place < self.last) & (offset < WINDOW)
        chance = dr.log(1.0 + dr.rcp(mi.Float(offset) + NEAREST)) / reach
        chance = dr.select(offset > 0, 0.5 * chance, chance)
        stands_for = dr.select(valid, dr.rcp(self.ratio * chance * count), 0.0)
        return taken(self.seen, mi.UInt32(place), valid), place, stands_for

    def holds(self, index: Any) -> Any:
        """Return whether ``drawn`` can find the vertex with that ``index``."""
        return dr.abs(dr.gather(mi.Int32, self.rank, index) - self.place) < WINDOW

    def index(self, place: Any) -> Any:
        """Return the index of the vertex at ``place``."""
        return dr.gather(mi.UInt32, self.order, mi.UInt32(place))


def _spread(x: Any) -> Any:
    """Return ``x`` of 16 bits with two zero bits between any two."""
    for shift, mask in (
        (16, 0x0000FF0000FF), (8, 0x00F00F00F00F), (4, 0x0C30C30C30C3), (2, 0x249249249249)
    ):  # fmt: skip
        x = (x | (x << shift)) & mi.UInt64(mask)
    return x
