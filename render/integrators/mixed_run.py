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
decided anew after every part of it. Short chains look better than they are: of rare bright light
they have seen nothing, so that their variance does not fall as they go on, and their inefficiency
grows. So it is reckoned with as it would be with all work of the run, growing on with every
doubling as it did with the last one. Where chains got more than their pilot, the mean weighs both
by their inverse variance.

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
PILOT_MUTATIONS = 32
"""Mutations of each chain in a pilot, made in two halves: from one to the next they double."""
PILOT_FRACTION = 1 / 16
"""Part of the whole run's work that a pilot takes, at most."""
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
        self._half: Array | None = None
        """Cells of the chains when they were half as long."""
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
        work = MUTATION_COST * PILOT_MUTATIONS + STARTS_PER_CHAIN
        count = max(self.settings.replicates, int(self.paths * PILOT_FRACTION / work))
        self.settings = replace(self.settings, chains=min(self.settings.chains, count))
        try:
            self.chains = self._started_chains()
            self.chains.sample(PILOT_MUTATIONS // 2)
            self._double(self.chains)
        except RenderError as error:
            # No path of the bootstrap carries light: plain samples find what there is.
            if error.field != "luminance_samples":
                raise
        lanes = len(self.plain.group)
        while (left := self.paths - self.plain_samples() - self._chain_work()) > 0.5 * lanes:
            afford = int(left / (MUTATION_COST * self.settings.chains))
            if self.chains is not None and self._chains_pay(self.chains):
                # The next decision knows of longer correlations.
                self._double(self.chains, afford)
            else:
                self.plain.sample(1)
        if self.chains is None or self.chains.done <= PILOT_MUTATIONS:
            # A pilot that lost says too little of its own error to be weighed in: on finger20 its
            # inverse variance made the picture worse.
            return self.plain.estimate()
        plain, chains = self._variances(
            self._cells(self.plain.estimate()), self._cells(self.chains.estimate())
        )
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

    def _double(self, chains: MarkovChains, most: int | None = None) -> None:
        """Make chains twice as long, by at most so many mutations each."""
        self._half = self._cells(chains.estimate())
        chains.sample(chains.done if most is None else max(1, min(chains.done, most)))

    def _chains_pay(self, chains: MarkovChains) -> bool:
        """Return whether further work lowers the error more in chains than in plain samples."""
        assert self._half is not None
        plain, mutated = (self._cells(run.estimate()) for run in (self.plain, chains))
        of_plain, half, whole = self._variances(plain, self._half, mutated)
        work = self._chain_work()
        expected = final_inefficiency(half, whole, work, self.paths)
        return bool(GAIN_MIN * expected < of_plain * self.plain_samples())

    def _variances(self, *estimates: Array) -> list[float]:
        """Return squared errors of cells ``(replicate, cell)``, relative to the level, summed.

        The level is the mean of the first estimate and the last.
        """
        level = 0.5 * (estimates[0].mean(axis=0) + estimates[-1].mean(axis=0))
        level = np.maximum(level, LEVEL_MIN * level.mean()) + np.finfo(np.float64).tiny
        return [float((cells / level).var(axis=0, ddof=1).sum()) for cells in estimates]

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


def final_inefficiency(half: float, whole: float, work: float, total: float) -> float:
    """Return what an inefficiency will be after the ``total`` work of a run.

    ``half`` and ``whole`` are variances of a half and of all of the ``work`` done. One that halves
    leaves the inefficiency as it is; else that grows with every doubling as with the last one.
    """
    growth = max(1.0, 2.0 * whole / half) if half > 0 else 1.0
    return float(whole * work * growth ** max(0.0, np.log2(total / work)))


def smoothed_level(pilot: Array, samples: float) -> Array:
    """Return the smoothed ``pilot`` ``(row, column)`` of so many samples, with dark parts lifted.

    The chains then visit all pixels alike; where it is 0 everywhere, the bootstrap says so.
    """
    # About KERNEL_SAMPLES under the kernel, and a few pixels at least.
    width = max(3.0, np.sqrt(KERNEL_SAMPLES * pilot.size / (4 * np.pi * samples)))
    level = gaussian_filter(pilot, width, mode="nearest")
    return np.asarray(np.maximum(level, LEVEL_MIN * pilot.mean()) + np.finfo(np.float32).tiny)
