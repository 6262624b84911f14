"""Random numbers of light paths: a stream of splitmix64 (Steele et al. 2014) for each path.

What a path draws depends on its family and number alone, on no thread and no other path.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from render.compiled import inlined

State = NDArray[np.uint64]
"""``(1,)``, the counter of a generator."""


@inlined
def uniform(state: State) -> float:
    """Return a number in [0, 1): splitmix64 (Steele et al. 2014) of the counter ``state``."""
    state[0] += np.uint64(0x9E3779B97F4A7C15)
    z = state[0]
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    return float(z >> np.uint64(11)) * 2.0**-53


@inlined
def begin_stream(state: State, key: int, index: int) -> None:
    """Start the stream of path ``index`` in the family ``key``: its numbers depend on these alone.

    ``state`` is ``(1,)``, the counter of a splitmix64 generator (Steele et al. 2014).
    """
    mixed = np.uint64(index) * np.uint64(0xD1342543DE82EF95) + np.uint64(key)
    mixed = (mixed ^ (mixed >> np.uint64(32))) * np.uint64(0xDABA0B6EB09322E3)
    mixed = (mixed ^ (mixed >> np.uint64(32))) * np.uint64(0xDABA0B6EB09322E3)
    state[0] = mixed ^ (mixed >> np.uint64(32))
