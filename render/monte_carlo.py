"""Plain Monte Carlo over the same problems: the independent check of the chains."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from render.bending import Array
from render.chains import LIGHT_SALT, Problem
from render.metropolis import key
from render.primary import ROUNDS, Hashed


def plain_replicates(
    problem: Problem, *, lanes: int, passes: int, replicates: int, seed: int
) -> Array:
    """Return independent estimates ``(replicate, bin, channel)`` from ``lanes * passes`` paths."""
    lane: Any = dr.arange(mi.UInt32, lanes)
    group = np.arange(lanes) % replicates
    sums = np.zeros((replicates, problem.bins, problem.channels))
    for number in range(passes):
        streams, _ = mi.sample_tea_32(lane, key(seed, 2, number), ROUNDS)
        deposits = problem.evaluate(Hashed(streams), Hashed(streams ^ LIGHT_SALT))
        dr.eval(deposits)
        for deposit in deposits:
            place = group * problem.bins + np.array(deposit.bin)
            for c, value in enumerate(deposit.values):
                paid = np.bincount(place, np.array(value, dtype=np.float64), sums[..., 0].size)
                sums[..., c] += paid.reshape(sums.shape[:2])
    return np.asarray(sums / (np.bincount(group) * passes)[:, None, None])
