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
TEA_STEP = 0x9E3779B9
Numbers: TypeAlias = "tuple[mi.Float, mi.Float, mi.Float, mi.Float]"
"""The four numbers of an event."""


def uniform(bits: mi.UInt32) -> mi.Float:
    """Return float32 numbers in [0, 1) from 32 random bits (24 are used)."""
    return mi.Float(bits >> 8) * (2.0**-24)


@dr.syntax
def tea(words: list[mi.UInt32]) -> list[mi.UInt32]:
    """Return two words of random bits for every two ``words``, as ``mi.sample_tea_32`` does.

    All rounds of all pairs are one loop: unrolled, they were a sixth of what LLVM compiled.
    """
    words, total = [mi.UInt32(word) for word in words], mi.UInt32(0)
    while total != ROUNDS * TEA_STEP % (1 << 32):
        total += TEA_STEP
        for i in range(0, len(words), 2):
            a, b = words[i], words[i + 1]
            a = a + (((b << 4) + 0xA341316C) ^ (b + total) ^ ((b >> 5) + 0xC8013EA4))
            b = b + (((a << 4) + 0xAD90777D) ^ (a + total) ^ ((a >> 5) + 0x7E95761E))
            words[i], words[i + 1] = a, b
    return words


def hashed(*events: tuple[mi.UInt32, mi.UInt32]) -> list[Numbers]:
    """Return the four uniform numbers of each event: those of a stream by its seed and a number."""
    words = [word for seed, i in events for k in range(2) for word in (seed, 2 * mi.UInt32(i) + k)]
    a = [uniform(word) for word in tea(words)]
    return [(a[i], a[i + 1], a[i + 2], a[i + 3]) for i in range(0, len(a), 4)]


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

    def events(self, *indices: mi.UInt32) -> list[Numbers]:
        """Return the numbers of several events."""
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
        return self.events(index)[0]

    def events(self, *indices: mi.UInt32) -> list[Numbers]:
        """Return the numbers of several events."""
        return hashed(*((self.seed, index) for index in indices))

    def of_lanes(self, lane: mi.UInt32) -> HashedStream:
        """Return the streams of the lanes ``lane``."""
        return HashedStream(dr.gather(mi.UInt32, self.seed, lane))

    def unless(self, there: mi.Bool, other: HashedStream) -> HashedStream:
        """Return these streams, but ``other`` ones where ``there``."""
        return HashedStream(dr.select(there, other.seed, self.seed))
