"""Which ways of a lamp's light are evaluated where, and with what probability.

At a facet the ways of most light are evaluated always and one of the others now and then; at every
vertex behind it one way of each lamp, drawn in proportion to its light. Where a window of another
index lies under the pad, vertices on the paint around it have ways of their own.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from render.arrays import Array

MAIN_SHARE = 0.05
"""Part of a lamp's light from which a way is evaluated at every facet, not now and then."""
LEAST_SHARE = 1e-5
"""Part of a lamp's light below which a way is left to camera subpaths."""
UNIFORM_SHARE = 0.2
"""Probability that falls to all ways alike where one of several is drawn."""
SLOTS = 256
"""Slots of equal probability by which ways are drawn."""


class WayDraws:
    """Draws entries, which number the ways of all lamps; ``entries`` itself stands for none."""

    def __init__(
        self, of_lamp: list[NDArray[np.int64]], strength: Array, from_window: NDArray[np.bool_]
    ) -> None:
        """Take the entries of each lamp, and of each entry its light and where it begins."""
        self.lamps, self.entries = len(of_lamp), len(strength)
        lamp_of = np.repeat(np.arange(self.lamps), [len(rows) for rows in of_lamp])
        facet, later = np.zeros(self.entries), np.zeros(self.entries)
        main: list[int] = []
        drawn = np.full((3, self.lamps, SLOTS), self.entries, dtype=np.uint32)
        some = False
        for lamp, rows in enumerate(of_lamp):
            for below in (False, True):
                here = rows[from_window[rows] == below]
                share = strength[here] / max(float(strength[here].sum()), 1e-300)
                taken, share = here[share > LEAST_SHARE], share[share > LEAST_SHARE]
                if not len(taken):
                    continue
                slots = _slots(share)
                drawn[1 + below, lamp] = taken[slots]
                later[taken] = np.bincount(slots, minlength=len(taken)) / SLOTS
                if below:
                    continue
                always = share > MAIN_SHARE
                main += taken[always].tolist()
                facet[taken[always]] = 1.0
                rest = taken[~always]
                if len(rest):
                    some = True
                    slots = _slots(share[~always])
                    drawn[0, lamp] = rest[slots]
                    facet[rest] = np.bincount(slots, minlength=len(rest)) / SLOTS
        self.main = len(main)
        self.facet_count = self.main + (self.lamps if some else 0)
        self.main_entry = mi.UInt32(np.array(main or [0], dtype=np.uint32))
        self.drawn = mi.UInt32(drawn.ravel())
        self.lamp_of = mi.UInt32(lamp_of.astype(np.uint32))
        self.chosen = mi.Float(np.concatenate([facet, [0.0], later, [0.0]]).astype(np.float32))
        dr.make_opaque(self.main_entry, self.drawn, self.lamp_of, self.chosen)

    def at_facet(self, step: mi.UInt32, number: mi.Float) -> tuple[mi.UInt32, mi.UInt32]:
        """Return entry and lamp of ``step`` of ``facet_count``, for a uniform ``number``.

        The main ways of all lamps come first, then one of the others for every lamp.
        """
        always = step < self.main
        entry = dr.gather(mi.UInt32, self.main_entry, dr.minimum(step, max(self.main, 1) - 1))
        other = dr.select(always, 0, step - self.main)
        entry = dr.select(always, entry, self._drawn(other, number))
        known = entry < self.entries
        lamp = dr.gather(mi.UInt32, self.lamp_of, dr.minimum(entry, self.entries - 1))
        return entry, dr.select(known, lamp, 0)

    def later(self, lamp: mi.UInt32, number: mi.Float, in_window: mi.Bool) -> mi.UInt32:
        """Return the entry of one way of ``lamp``, for vertices behind the facet."""
        return self._drawn(dr.select(in_window, 2 * self.lamps, self.lamps) + lamp, number)

    def _drawn(self, row: mi.UInt32, number: mi.Float) -> mi.UInt32:
        slot = dr.minimum(mi.UInt32(number * SLOTS), SLOTS - 1)
        return dr.gather(mi.UInt32, self.drawn, row * SLOTS + slot)

    def probability(self, entry: mi.UInt32, facet: mi.Bool) -> mi.Float:
        """Return with what probability a vertex evaluates ``entry``."""
        at = dr.select(facet, entry, self.entries + 1 + entry)
        return dr.gather(mi.Float, self.chosen, at)


def _slots(share: Array) -> NDArray[np.int64]:
    """Return which way each slot draws, ``(slot,)``, from their shares ``(way,)``."""
    if not len(share):
        return np.zeros(0, dtype=np.int64)
    total = share.sum()
    even = np.full(len(share), 1 / len(share))
    mixed = (1 - UNIFORM_SHARE) * (share / total if total > 0 else even) + UNIFORM_SHARE * even
    # Each way has one slot at least.
    counts = np.maximum(1, np.floor(mixed * SLOTS)).astype(np.int64)
    counts[counts.argmax()] += SLOTS - counts.sum()
    return np.repeat(np.arange(len(share)), counts)
