"""The mean of a film's target, on which the brightness of a Metropolis picture rests.

Kelemen et al. 2002 take it from the paths that start the chains. Here most samples go into plain
Monte Carlo made for this one number: film positions where a pilot found the target to vary
(the standard deviation per pixel is the best density: Neyman 1934), strata, and light subpaths
shared by many camera subpaths (``render.integrators.vertex_cache``).
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.ndimage import gaussian_filter

from render.arrays import Array
from render.errors import RenderError
from render.integrators.film_sampler import FilmSampler
from render.integrators.vertex_cache import SHARED
from render.sampling.proposals import LIGHT_SALT
from render.sampling.streams import ROUNDS, Hashed, key

# Paths of one pass.
LANES = 1 << 17
# Samples under the kernel that smooths the pilot's second moments, and the share of samples that
# all pixels get alike.
ENOUGH, EVEN = 64.0, 0.2
# Rows and columns of cells that tell film positions apart, at most.
CELLS = 128


class Normalization:
    """Spends ``samples`` pairs of subpaths: a pilot, starts of chains, and the scale itself."""

    def __init__(
        self, problem: FilmSampler, samples: int, chains: int, replicates: int, seed: int
    ) -> None:
        """Divide the samples; ``chains`` of them should each find their own start."""
        self.problem, self.replicates, self.seed = problem, replicates, seed
        self.for_pilot = max(samples // 8, replicates)
        self.starts = min(max(samples // 8, 4 * chains), samples // 2)
        self.for_scale = max(samples - self.for_pilot - self.starts, replicates)
        rows, columns = min(problem.height, CELLS), min(problem.width, CELLS)
        row, column = np.divmod(np.arange(problem.bins), problem.width)
        self.shape = (rows, columns)
        self.cell = row * rows // problem.height * columns + column * columns // problem.width
        self.second: Array = np.ones(self.shape)

    def pilot(self) -> Array:
        """Return a picture ``(pixel, channel)``; where it varies is kept for ``means``."""
        bins, channels = self.problem.bins, self.problem.channels
        cells = self.second.size
        total, second = np.zeros((bins, channels)), np.zeros(cells)
        lanes, passes = _passes(self.for_pilot)
        together = self.problem.together(lanes, 1, SHARED, self.second)
        for number in range(passes):
            camera, splat = _evaluated(together, lanes, key(self.seed, 4, number))
            for bin_, values in (camera, splat):
                for c in range(channels):
                    total[:, c] += np.bincount(bin_, values[c], bins)
            square = np.sum(camera[1], axis=0) ** 2
            second += np.bincount(self.cell[camera[0]], square, cells)
        paths = lanes * passes
        width = np.sqrt(ENOUGH * cells / (4 * np.pi * paths))
        smooth = gaussian_filter(second.reshape(self.shape), max(1.0, width), mode="nearest")
        self.second = smooth
        return np.asarray(total / paths)

    def means(self, weights: Array) -> Array:
        """Return independent estimates ``(replicate,)`` of the target's mean.

        The target is the sum of ``weights[pixel, channel] * value`` over a path's deposits.

        Raises:
            RenderError: when a path returns a value that is not finite.
        """
        weight = np.bincount(self.cell, weights.mean(axis=1)) / np.bincount(self.cell)
        density = np.sqrt(self.second) * weight.reshape(self.shape)
        mean = density.mean()
        density = (1 - EVEN) * density + EVEN * mean if mean > 0 else np.ones(self.shape)
        lanes, passes = _passes(self.for_scale)
        lanes = max(lanes, self.replicates)
        together = self.problem.together(lanes, self.replicates, SHARED, density)
        group = np.arange(lanes) % self.replicates
        sums = np.zeros(self.replicates)
        for number in range(passes):
            for bin_, values in _evaluated(together, lanes, key(self.seed, 5, number)):
                target = sum(value * weights[bin_, c] for c, value in enumerate(values))
                sums += np.bincount(group, target, self.replicates)
        return np.asarray(sums / (np.bincount(group) * passes))


def _passes(samples: int) -> tuple[int, int]:
    """Return lanes and passes that make up about as many samples."""
    passes = -(-samples // LANES)
    return -(-samples // passes), passes


def _evaluated(problem: FilmSampler, lanes: int, salt: Any) -> list[tuple[Array, list[Array]]]:
    """Return bins and values per channel of each deposit of one pass."""
    lane: Any = dr.arange(mi.UInt32, lanes)
    streams, _ = mi.sample_tea_32(lane, salt, ROUNDS)
    deposits = problem.evaluate(Hashed(streams), Hashed(streams ^ LIGHT_SALT))
    dr.eval(deposits)
    found = []
    for deposit in deposits:
        values = [np.array(value, dtype=np.float64) for value in deposit.values]
        if not all(np.isfinite(value).all() for value in values):
            raise RenderError("the path sampler returned a non-finite value")
        found.append((np.array(deposit.bin), values))
    return found
