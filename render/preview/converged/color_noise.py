"""What traced light knows of its own photon noise, from the halves of its light paths.

Photons and paths are followed in two halves, each path with its own random numbers. What a half
finds is an independent estimate from half as many paths: with ``X_a`` and ``X_b`` of the halves,
the whole is ``X = (X_a + X_b) / 2``, and ``d = (X_a - X_b) / 2`` has the mean 0 and the variance of
X: the jackknife over two batches (Efron 1982). Transport is a product of what lamps send, what
facets get of it and what the coating's patches send on, so d follows by the product rule, which for
halves is exact. It costs no photon. Starts of paths are evenly spread over the whole, better than
over halves, so noise that they make is overstated (by sqrt 2 at most). Noise of tens of percent is
understated: a facet that a rare photon lights is bright and noisy at once.
"""

from __future__ import annotations

import math
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from render.arrays import Array

T = TypeVar("T")

NOISE_LIMIT = 0.03
"""Color noise above which photons are followed again."""
MAX_ROUNDS = 3
"""How often photons are followed at most where it is not said otherwise, each time with a seed of
its own."""
DESIGNS = 64
"""Random designs whose colors are looked at."""
DESIGN_SEED = 31
DIM = 0.1
"""Facets darker than so much of the rms light over the facets of a design are left out."""


class Halved(NamedTuple, Generic[T]):
    """What light paths find, and half the difference between what their two halves find."""

    whole: T
    difference: T


def halved_product(a: Halved[Array], b: Halved[Array]) -> Halved[Array]:
    """Return the matrix product of two, whose paths are independent or halved alike."""
    return Halved(
        a.whole @ b.whole,
        a.difference @ b.whole + a.whole @ b.difference,
    )


def halved_sum(a: Halved[Array], b: Halved[Array]) -> Halved[Array]:
    """Return the sum of two."""
    return Halved(a.whole + b.whole, a.difference + b.difference)


def color_noise(cells: Halved[Array], channels: int) -> float:
    """Return the photon noise of a facet's color, relative to the color, rms over facets.

    The colors are those of `DESIGNS` random designs: each lamp is lit in one random channel and
    points in one random direction of the nodes. The noise of a color c ``(channel,)`` is
    ``|d| / |c|`` with d its `Halved.difference`; the mean of its square is taken over all facets
    of all designs whose ``|c|`` is at least `DIM` times the design's rms. 1 where no light was
    found at all. It is one standard deviation, of 1 degree of freedom for every facet.

    Arguments:
        cells: ``(lamp, node, site, facet)``.
        channels: of the camera.
    """
    rng = np.random.default_rng(DESIGN_SEED)
    lamps, nodes = cells.whole.shape[:2]
    node = rng.integers(nodes, size=(DESIGNS, lamps))
    channel = np.eye(channels)[rng.integers(channels, size=(DESIGNS, lamps))]
    square, noise = (
        (np.einsum("dlsf,dlc->dsfc", of[np.arange(lamps), node], channel, optimize=True) ** 2)
        .sum(axis=-1)
        .reshape(DESIGNS, -1)
        for of in cells
    )
    counted = square > 0.0
    counted &= square >= DIM**2 * square.mean(axis=1, keepdims=True)
    if not counted.any():
        return 1.0
    return math.sqrt(float(np.mean(noise[counted] / square[counted])))
