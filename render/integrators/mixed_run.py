"""Plain Monte Carlo and Markov chains over one film, the chains only where they lower the error.

Plain samples are those of ``bdpt``: shared light vertices, strata, every one of them deposited.
They also fix what the chains need: the normalization constant b, the mean of the target F (Kelemen
et al. 2002, sec. 4.1), and the level by which F flattens the film. Then the chains make a few
mutations as a pilot. Both are independent estimates of one picture in independent replicates, so
replicates say how much variance is left in cells of the film, and what each of them makes of its
samples,

    inefficiency = variance * samples * cost of a sample,

with correlated mutations counted as what they are. Inverse variances of independent estimates add
up, and each grows with the work that is done; so all further work goes to the less inefficient one,
decided anew after every part of it. Where chains got more than their pilot, the mean weighs both by
their inverse variance.

Costs are constants, not measured times: a seed gives the same picture on any machine. The picture
is consistent: it is unbiased for a fixed division of the work, and the division follows the
samples. With few samples (``PILOT_MIN``) there are no chains, and the picture is that of ``bdpt``.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter

from render.arrays import Array
from render.errors import RenderError
from render.integrators.film_sampler import FilmSampler
from render.integrators.vertex_cache import SHARED_PATHS
from render.sampling.monte_carlo import MonteCarlo
from render.sampling.pssmlt import ChainSettings, MarkovChains

LANES = 1 << 18
"""Lanes of one pass; every pass is traced anew."""
PILOT_MIN = 1 << 21
"""Samples below which a pilot of chains would cost too much of the time."""
PILOT_MUTATIONS = 4
"""Mutations of each chain in a pilot."""
PILOT_FRACTION = 1 / 256
"""Chains per sample of the whole run, at most: a pilot then takes about a tenth of it."""
STARTS_PER_CHAIN = 4
"""Bootstrap samples for each chain."""
MUTATION_COST = 1.2
"""Time of a mutation over that of a plain sample, as measured on slabs and on finger20."""
GAIN_MIN = 1.5
"""How much less inefficient chains have to be: a short pilot flatters them."""
CELLS_MAX = 12
"""Rows and columns of cells over which variances are taken, at most."""
PLAIN_WORTH = 3.0
"""Samples of the chains' own path function that a plain one is worth, which shares vertices."""
KERNEL_SAMPLES = 256.0
"""Samples under the kernel that smooths the level."""
LEVEL_MIN = 0.02
"""Least level, relative to the mean."""


class MixedRun:
    """One run of about ``paths`` samples of a film; ``settings`` are the chains'."""

    def __init__(self, sampler: FilmSampler, settings: ChainSettings, paths: int) -> None:
        """Set up; nothing is traced before ``sample``."""
        self.sampler, self.settings, self.paths = sampler, settings, paths
        self.plain = self._plain_run(paths)
        self.chains: MarkovChains | None = None
        row, column = np.divmod(np.arange(sampler.bins), sampler.width)
        rows, columns = min(sampler.height, CELLS_MAX), min(sampler.width, CELLS_MAX)
        self.cell = row * rows // sampler.height * columns + column * columns // sampler.width

    def _plain_run(self, paths: int) -> MonteCarlo:
        """Return plain Monte Carlo whose passes make up so many paths, or a few more."""
        replicates = self.settings.replicates
        lanes = max(-(-paths // -(-paths // LANES)), replicates)
        sharing = self.sampler.sharing(lanes, replicates, SHARED_PATHS)
        return MonteCarlo(sharing, lanes, replicates, self.settings.seed)

    def sample(self) -> Array:
        """Return independent images ``(replicate, pixel, channel)``."""
        if self.paths < PILOT_MIN:
            while self.plain_samples() < self.paths:
                self.plain.sample(1)
            return self.plain.estimate()
        self.plain.sample(1)
        count = max(self.settings.replicates, int(self.paths * PILOT_FRACTION))
        self.settings = replace(self.settings, chains=min(self.settings.chains, count))
        try:
            self.chains = self._started_chains()
            self.chains.sample(PILOT_MUTATIONS)
        except RenderError as error:
            # No path of the bootstrap carries light: plain samples find what there is.
            if error.field != "luminance_samples":
                raise
        lanes = len(self.plain.group)
        while (left := self.paths - self.plain_samples() - self._chain_work()) > 0.5 * lanes:
            if self.chains is not None and self._chains_pay(self.chains):
                # As much as they have had: the next decision knows of longer correlations.
                afford = int(left / (MUTATION_COST * self.settings.chains))
                self.chains.sample(max(1, min(self.chains.done, afford)))
            else:
                self.plain.sample(1)
        if self.chains is None or self.chains.done <= PILOT_MUTATIONS:
            # A pilot that lost says too little of its own error to be weighed in: on finger20 its
            # inverse variance made the picture worse.
            return self.plain.estimate()
        plain, chains = self._variances(self.chains)
        weight = plain / (plain + chains) if plain + chains > 0 else 0.0
        return np.asarray((1.0 - weight) * self.plain.estimate() + weight * self.chains.estimate())

    def sample_chains_only(self) -> Array:
        """Return images of the chains alone, whose b is from ``luminance_samples`` plain ones."""
        self.plain = self._plain_run(self.settings.luminance_samples)
        while self.plain_samples() < self.settings.luminance_samples:
            self.plain.sample(1)
        chains = self._started_chains()
        chains.sample(max(1, round(self.paths / self.settings.chains)))
        return chains.estimate()

    def plain_samples(self) -> int:
        """Return the number of plain samples so far."""
        return self.plain.done * len(self.plain.group)

    def chain_share(self) -> float:
        """Return the part of the work that went into chains, starts and pilot included."""
        return self._chain_work() / (self._chain_work() + self.plain_samples())

    def _chain_work(self) -> float:
        if self.chains is None:
            return 0.0
        return (MUTATION_COST * self.chains.done + STARTS_PER_CHAIN) * self.settings.chains

    def _chains_pay(self, chains: MarkovChains) -> bool:
        """Return whether further work lowers the error more in chains than in plain samples."""
        plain, mutated = self._variances(chains)
        return GAIN_MIN * mutated * self._chain_work() < plain * self.plain_samples()

    def _variances(self, chains: MarkovChains) -> tuple[float, float]:
        """Return the squared errors relative to the level, summed over cells, of both estimates."""
        pictures = [self._cells(images) for images in (self.plain.estimate(), chains.estimate())]
        level = np.mean([picture.mean(axis=0) for picture in pictures], axis=0)
        level = np.maximum(level, LEVEL_MIN * level.mean()) + np.finfo(np.float64).tiny
        plain, mutated = (float((p / level).var(axis=0, ddof=1).sum()) for p in pictures)
        return plain, mutated

    def _cells(self, images: Array) -> Array:
        """Return sums over channels and cells of the film ``(replicate, cell)``."""
        gray = images.sum(axis=2)
        return np.stack([np.bincount(self.cell, image) for image in gray])

    def _started_chains(self) -> MarkovChains:
        """Start chains with the target F: luminance over the level that plain samples show."""
        sampler, images = self.sampler, self.plain.estimate()
        weights = np.array([1.0] if sampler.channels == 1 else [0.2126, 0.7152, 0.0722])
        pilot = (images.mean(axis=0) @ weights).reshape(sampler.height, sampler.width)
        flat = weights / smoothed_level(pilot, self.plain_samples()).reshape(-1, 1)
        chains = MarkovChains(sampler, self.settings)
        chains.bootstrap(flat, STARTS_PER_CHAIN * self.settings.chains)
        worth = PLAIN_WORTH * self.plain_samples() / self.settings.replicates
        chains.add_estimates(np.einsum("rpc,pc->r", images, flat), worth)
        return chains


def smoothed_level(pilot: Array, samples: float) -> Array:
    """Return the smoothed ``pilot`` ``(row, column)`` of so many samples, with dark parts lifted.

    The chains then visit all pixels alike; where it is 0 everywhere, the bootstrap says so.
    """
    # About KERNEL_SAMPLES under the kernel, and a few pixels at least.
    width = max(3.0, np.sqrt(KERNEL_SAMPLES * pilot.size / (4 * np.pi * samples)))
    level = gaussian_filter(pilot, width, mode="nearest")
    return np.asarray(np.maximum(level, LEVEL_MIN * pilot.mean()) + np.finfo(np.float32).tiny)
