"""Primary samples: uniform numbers addressed by event, from a counter-based hash.

A path is a function of numbers ``u[event][0..3]`` in [0, 1). Any event can be asked for in any
order, so nothing has to be stored for plain Monte Carlo and only the first events of a chain have
to be stored for Metropolis (``render.sampling.proposals``).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import drjit as dr
import mitsuba as mi

# Four rounds pass the spectral tests of Zafar et al. 2010 for rendering; six is their safe choice.
ROUNDS = 6


def uniform(bits: Any) -> Any:
    """Return float32 numbers in [0, 1) from 32 random bits (24 are used)."""
    return mi.Float(bits >> 8) * (2.0**-24)


def hashed(seed: Any, event: Any) -> tuple[Any, Any, Any, Any]:
    """Return the four uniform numbers of ``event`` for the streams ``seed`` (uint32 arrays)."""
    a, b = mi.sample_tea_32(seed, 2 * event, ROUNDS)
    c, d = mi.sample_tea_32(seed, 2 * event + 1, ROUNDS)
    return uniform(a), uniform(b), uniform(c), uniform(d)


def key(seed: int, purpose: int, index: int) -> Any:
    """Return an opaque uint32 that differs for every seed, purpose and index (splitmix64)."""
    word = (seed * 0x9E3779B97F4A7C15 + (purpose << 40) + index) & 0xFFFFFFFFFFFFFFFF
    for multiplier in (0xBF58476D1CE4E5B9, 0x94D049BB133111EB):
        word = ((word ^ (word >> 30)) * multiplier) & 0xFFFFFFFFFFFFFFFF
    value = mi.UInt32(word >> 32)
    dr.make_opaque(value)
    return value


class Stream(Protocol):
    """Primary samples by event; see the module's description."""

    def event(self, index: Any) -> tuple[Any, Any, Any, Any]:
        """Return the four numbers of event ``index`` (uint32 array)."""
        ...

    def spread(self, lane: Any) -> Stream:
        """Return the streams of the lanes ``lane`` (uint32 array)."""
        ...


@dataclass
class Hashed:
    """The plain Monte Carlo stream: every event is hashed from the lane's seed."""

    seed: Any

    def event(self, index: Any) -> tuple[Any, Any, Any, Any]:
        """Return the four numbers of event ``index`` (uint32 array)."""
        return hashed(self.seed, mi.UInt32(index))

    def spread(self, lane: Any) -> Hashed:
        """Return the streams of the lanes ``lane`` (uint32 array)."""
        return Hashed(dr.gather(mi.UInt32, self.seed, lane))
