"""How the samples of a render are shared among its pads, sites and fibers.

Every sample serves one site under one fiber. Unless told otherwise, near fibers get more of them,
which make the colors, and all sites and bends the same. Where only some numbers matter, like the
scores of a few designs, samples can follow those: a share of `FLOOR` goes on as before, so that
nothing is left unseen, however wrong the rest may be (defensive sampling: Hesterberg 1995). Then no
estimate of a cell has more than 1 / FLOOR times its variance at the same effort.

Probabilities are whole numbers of slots, so what divides a sample is known exactly. Any number of
slots above 0 is right; it decides about the noise alone.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from render.arrays import Array
from render.geometry import counted_sites, facets, fiber_poses
from render.scene import Scene

SLOTS = 512
"""Slots of equal probability per site by which fibers are chosen."""
UNIFORM_FRACTION = 0.4
"""Fraction of the samples of a site that falls to all fibers alike, so that dim ones are known too.

The rest falls to near ones.
"""
FLOOR = 0.5
"""Fraction of the samples of a render that does not follow what was asked for.

Shares follow what noise does to first order. Scores of few samples feel its square too, and with
0.3 the difference of two designs that are nearly alike was known worse than without.
"""


def near_shares(site: Array, fiber: Array, lit: NDArray[np.bool_] | None = None) -> Array:
    """Return the shares ``(site, fiber)`` of a site's samples, from positions ``(..., 3)`` mm.

    A uniform part plus the inverse square of the distance. Where ``lit`` ``(site, fiber)`` is
    given, only its fibers have any at a site that has some.
    """
    chosen = np.ones((len(site), len(fiber)))
    if lit is not None:
        chosen = np.where(lit.any(axis=1, keepdims=True), lit, chosen)
    near = chosen / ((site[:, None] - fiber[None]) ** 2).sum(axis=-1)
    uniform = UNIFORM_FRACTION * chosen / chosen.sum(axis=1, keepdims=True)
    shares = uniform + (1.0 - UNIFORM_FRACTION) * near / near.sum(axis=1, keepdims=True)
    return np.asarray(shares, dtype=np.float64)


def near_slots(site: Array, fiber: Array, lit: NDArray[np.bool_] | None = None) -> np.ndarray:
    """Return how many of the `SLOTS` of a site each fiber has, ``(site, fiber)``; see above."""
    middle = (np.arange(SLOTS) + 0.5) / SLOTS
    edges = np.cumsum(near_shares(site, fiber, lit), axis=1)
    chosen = [np.searchsorted(row / row[-1], middle) for row in edges]
    return np.stack([np.bincount(row, minlength=len(fiber)) for row in chosen])


def floored_shares(scene: Scene, bends: Array, wanted: Array) -> Array:
    """Return shares ``(bend, site, fiber)`` of all samples: those ``wanted``, over the floor.

    ``wanted`` are numbers of at least 0, of sites that count; their sum is of no account, and
    where all are 0 the samples are spread as usual.
    """
    counted = counted_sites(scene)
    usual = np.stack(
        [
            near_shares(
                facets(scene, bend).site_position[counted], fiber_poses(scene, bend).position
            )
            for bend in bends
        ]
    )
    usual = usual / usual.sum()
    if not wanted.sum() > 0:
        return usual
    return np.asarray(FLOOR * usual + (1.0 - FLOOR) * wanted / wanted.sum())


def pad_slots(shares: Array) -> np.ndarray:
    """Return slots ``(site, fiber)`` of one pad in proportion to ``shares``, at least one each.

    Their sum is a multiple of `SLOTS`, large enough that rounding moves no share by much.
    """
    sites, fibers = shares.shape
    total = SLOTS * sites * -(-fibers // (SLOTS // 8))
    exact = shares / shares.sum() * total
    slots = np.maximum(np.floor(exact).astype(np.int64), 1)
    # What rounding left goes where most is missing; what it took too much, where most is.
    while (rest := total - int(slots.sum())) != 0:
        order = np.argsort((slots - exact).ravel(), kind="stable")
        if rest < 0:
            order = np.array([i for i in order[::-1] if slots.ravel()[i] > 1])
        slots.ravel()[order[: abs(rest)]] += np.sign(rest)
    return slots
