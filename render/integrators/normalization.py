"""The normalization constant b of a film, on which the brightness of a Metropolis picture rests.

It is the mean of the target F (Kelemen et al. 2002, sec. 4.1), which there comes from the paths
that start the chains. Here most samples go into plain
Monte Carlo made for this one number: film positions where a pilot found the target to vary
(the standard deviation per pixel is the best density: Neyman 1934), strata, and light subpaths
shared by many camera subpaths (``render.integrators.vertex_cache``).
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.ndimage import gaussian_filter

from render.arrays import Array
from render.integrators.film_sampler import FilmSampler
from render.integrators.vertex_cache import SHARED_PATHS
from render.sampling.monte_carlo import finite_values, independent_paths
from render.sampling.streams import key

LANES = 1 << 17
"""Paths of one pass."""
KERNEL_SAMPLES = 64.0
"""Samples under the kernel that smooths the pilot's second moments."""
UNIFORM_FRACTION = 0.2
"""Fraction of samples that all pixels get alike."""
CELLS_MAX = 128
"""Rows and columns of cells that tell film positions apart, at most."""


class Normalization:
    """Spends ``samples`` pairs of subpaths: a pilot, starts of chains, and b itself."""

    def __init__(
        self, sampler: FilmSampler, samples: int, chains: int, replicates: int, seed: int
    ) -> None:
        """Divide the samples; ``chains`` of them should each find their own start."""
        self.sampler, self.replicates, self.seed = sampler, replicates, seed
        self.for_pilot = max(samples // 8, replicates)
        self.for_starts = min(max(samples // 8, 4 * chains), samples // 2)
        self.for_estimate = max(samples - self.for_pilot - self.for_starts, replicates)
        rows, columns = min(sampler.height, CELLS_MAX), min(sampler.width, CELLS_MAX)
        row, column = np.divmod(np.arange(sampler.bins), sampler.width)
        self.shape = (rows, columns)
        self.cell = row * rows // sampler.height * columns + column * columns // sampler.width
        self.second: Array = np.ones(self.shape)

    def pilot(self) -> Array:
        """Return a picture ``(pixel, channel)``; where it varies is kept for ``means``."""
        bins, channels = self.sampler.bins, self.sampler.channels
        cells = self.second.size
        total, second = np.zeros((bins, channels)), np.zeros(cells)
        lanes, passes = _passes(self.for_pilot)
        sharing = self.sampler.sharing(lanes, 1, SHARED_PATHS, self.second)
        for number in range(passes):
            camera, splat = _evaluated(sharing, lanes, key(self.seed, 4, number))
            for bin_, values in (camera, splat):
                for c in range(channels):
                    total[:, c] += np.bincount(bin_, values[c], bins)
            square = np.sum(camera[1], axis=0) ** 2
            second += np.bincount(self.cell[camera[0]], square, cells)
        paths = lanes * passes
        width = np.sqrt(KERNEL_SAMPLES * cells / (4 * np.pi * paths))
        kernel = max(1.0, width)
        self.second = gaussian_filter(second.reshape(self.shape), kernel, mode="nearest")
        return np.asarray(total / paths)

    def means(self, weights: Array) -> Array:
        """Return independent estimates ``(replicate,)`` of b.

        The target is the sum of ``weights[pixel, channel] * value`` over a path's splats.

        Raises:
            RenderError: when a path returns a value that is not finite.
        """
        weight = np.bincount(self.cell, weights.mean(axis=1)) / np.bincount(self.cell)
        density = np.sqrt(self.second) * weight.reshape(self.shape)
        mean = density.mean()
        density = (
            (1 - UNIFORM_FRACTION) * density + UNIFORM_FRACTION * mean
            if mean > 0
            else np.ones(self.shape)
        )
        lanes, passes = _passes(self.for_estimate)
        lanes = max(lanes, self.replicates)
        sharing = self.sampler.sharing(lanes, self.replicates, SHARED_PATHS, density)
        group = np.arange(lanes) % self.replicates
        sums = np.zeros(self.replicates)
        for number in range(passes):
            for bin_, values in _evaluated(sharing, lanes, key(self.seed, 5, number)):
                target = sum(value * weights[bin_, c] for c, value in enumerate(values))
                sums += np.bincount(group, target, self.replicates)
        return np.asarray(sums / (np.bincount(group) * passes))


def _passes(samples: int) -> tuple[int, int]:
    """Return lanes and passes that make up about as many samples."""
    passes = -(-samples // LANES)
    return -(-samples // passes), passes


def _evaluated(
    sampler: FilmSampler, lanes: int, salt: mi.UInt32
) -> list[tuple[Array, list[Array]]]:
    """Return bins and values per channel of each splat of one pass."""
    splats, _ = independent_paths(sampler, dr.arange(mi.UInt32, lanes), salt)
    return [(np.array(splat.bin), finite_values(splat)) for splat in splats]
