"""Primary samples: uniform numbers addressed by event, from a counter-based hash.

A path is a function of numbers ``u[event][0..3]`` in [0, 1). Any event can be asked for in any
order, so nothing has to be stored for plain Monte Carlo and only the first events of a chain have
to be stored for Metropolis (``render.sampling.proposals``).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias

import drjit as dr
import mitsuba as mi

ROUNDS = 6
"""Of the hash; four pass the spectral tests of Zafar et al. 2010, six are their safe choice."""
Numbers: TypeAlias = "tuple[mi.Float, mi.Float, mi.Float, mi.Float]"
"""The four numbers of an event."""


def uniform(bits: mi.UInt32) -> mi.Float:
    """Return float32 numbers in [0, 1) from 32 random bits (24 are used)."""
    return mi.Float(bits >> 8) * (2.0**-24)


def hashed(seed: mi.UInt32, event: mi.UInt32) -> Numbers:
    """Return the four uniform numbers of ``event`` for the streams ``seed``."""
    a, b = mi.sample_tea_32(seed, 2 * event, ROUNDS)
    c, d = mi.sample_tea_32(seed, 2 * event + 1, ROUNDS)
    return uniform(a), uniform(b), uniform(c), uniform(d)


def key(seed: int, purpose: int, index: int) -> mi.UInt32:
    """Return an opaque number that differs for every seed, purpose and index (splitmix64)."""
    word = (seed * 0x9E3779B97F4A7C15 + (purpose << 40) + index) & 0xFFFFFFFFFFFFFFFF
    for multiplier in (0xBF58476D1CE4E5B9, 0x94D049BB133111EB):
        word = ((word ^ (word >> 30)) * multiplier) & 0xFFFFFFFFFFFFFFFF
    value = mi.UInt32(word >> 32)
    dr.make_opaque(value)
    return value


class Stream(Protocol):
    """Primary samples by event; see the module's description."""

    def event(self, index: mi.UInt32) -> Numbers:
        """Return the four numbers of event ``index``."""
        ...

    def of_lanes(self, lane: mi.UInt32) -> Stream:
        """Return the streams of the lanes ``lane``."""
        ...

    def unless(self, there: mi.Bool, other: Any) -> Stream:
        """Return these streams, but ``other`` ones of the same kind where ``there``."""
        ...


@dataclass
class HashedStream:
    """The plain Monte Carlo stream: every event is hashed from the lane's seed."""

    seed: mi.UInt32

    def event(self, index: mi.UInt32) -> Numbers:
        """Return the four numbers of event ``index``."""
        return hashed(self.seed, mi.UInt32(index))

    def of_lanes(self, lane: mi.UInt32) -> HashedStream:
        """Return the streams of the lanes ``lane``."""
        return HashedStream(dr.gather(mi.UInt32, self.seed, lane))

    def unless(self, there: mi.Bool, other: HashedStream) -> HashedStream:
        """Return these streams, but ``other`` ones where ``there``."""
        return HashedStream(dr.select(there, other.seed, self.seed))
