"""Plain Monte Carlo and Markov chains over one film, the chains only where they lower the error.

Plain samples are those of ``bdpt``: shared light vertices, strata, every one of them deposited.
They come first and take most of the work, so that chains that win nothing cost little
(``CHAINS_FRACTION``). They also fix what the chains need: the normalization constant b, the mean of
the target F (Kelemen et al. 2002, sec. 4.1), and the level by which F flattens the film. Then the
chains make a few mutations as a pilot. Both are independent estimates of one picture in independent
replicates, so replicates say how much variance is left in cells of the film, and what each of them
makes of its samples,

    inefficiency = variance * work,

with correlated mutations counted as what they are. Inverse variances of independent estimates add
up, and each grows with the work that is done; so what is left of the work goes to the less
inefficient one, decided anew after every part of it.

Short chains look better than they are: replicates that have not met rare bright light agree on a
picture without it. Two things tell. Their variance does not fall as they go on, so their
inefficiency is reckoned with as it would be with all work of the run, growing on with every
doubling as it did with the last one. And plain samples have met that light: the squared distance of
two independent means is the sum of their variances in the mean, so less that of the plain ones it
states the chains' own, light that no chain has met included (``variance_apart``). The larger one
counts. Where chains got more than their pilot, the mean weighs both by their inverse variance.

Work is counted in plain samples, by constants, not by a clock: a seed gives the same picture on any
machine. What counts most in a short run is the pass itself (``PASS_COST``). The picture is
consistent: it is unbiased for a fixed division of the work, and the division follows the samples.
With fewer samples than ``PILOT_MIN`` there are no chains, and the picture is that of ``bdpt``.
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
PILOT_MIN = 1 << 25
"""Samples from which on a pilot of 16,384 chains costs little."""
PILOT_MUTATIONS = 32
"""Mutations of each chain in a pilot, made in two halves: from one to the next they double."""
PILOT_FRACTION = 1 / 16
"""Part of the whole run's work that a pilot takes, at most."""
CHAINS_FRACTION = 3 / 16
"""Part of it that chains take at most, pilot included: wholly wasted, it costs 11 % of error."""
STARTS_PER_CHAIN = 4
"""Bootstrap samples for each chain."""
MUTATION_COST = 1.0
"""Time of a mutation over that of a plain sample."""
PASS_COST = 15_000
"""Time of a pass of chains besides its mutations, in plain samples: each is traced in Python anew.

Both costs are upper ends of what ``tests/benchmarks/test_pssmlt.py`` measures on three scenes.
"""
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
        self._half, self._whole = np.zeros((2, settings.replicates, 1))
        """Cells of the chains when they were half as long, and as they are."""
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
        while self.plain_samples() < (1.0 - CHAINS_FRACTION) * self.paths:
            self.plain.sample(1)
        passes = PILOT_MUTATIONS + STARTS_PER_CHAIN + 1
        count = int((PILOT_FRACTION * self.paths / passes - PASS_COST) / MUTATION_COST)
        count = max(self.settings.replicates, count)
        self.settings = replace(self.settings, chains=min(self.settings.chains, count))
        try:
            self.chains = self._started_chains()
            for _ in range(2):
                self._lengthen(self.chains, PILOT_MUTATIONS // 2)
        except RenderError as error:
            # No path of the bootstrap carries light: plain samples find what there is.
            if error.field != "luminance_samples":
                raise
        lanes = len(self.plain.group)
        while (left := self.paths - self.plain_samples() - self._chain_work()) > 0.5 * lanes:
            afford = int(left / self._pass_work())
            if self.chains is not None and self._chains_pay():
                # They double: the next decision knows of longer correlations.
                self._lengthen(self.chains, max(1, min(self.chains.done, afford)))
            else:
                self.plain.sample(1)
        if self.chains is None or self.chains.done <= PILOT_MUTATIONS:
            # A pilot that lost says too little of its own error to be weighed in: on finger20 its
            # inverse variance made the picture worse.
            return self.plain.estimate()
        plain, _, chains = self._variances()
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

    def _pass_work(self) -> float:
        """Return the work of one mutation in every chain, and of one start in every chain."""
        return PASS_COST + MUTATION_COST * self.settings.chains

    def _chain_work(self) -> float:
        if self.chains is None:
            return 0.0
        return (self.chains.done + STARTS_PER_CHAIN + 1) * self._pass_work()

    def _lengthen(self, chains: MarkovChains, mutations: int) -> None:
        """Add so many mutations to each chain."""
        chains.sample(mutations)
        self._half, self._whole = self._whole, self._cells(chains.estimate())

    def _chains_pay(self) -> bool:
        """Return whether further work lowers the error more in chains than in plain samples."""
        of_plain, half, whole = self._variances()
        expected = final_inefficiency(half, whole, self._chain_work(), self.paths)
        return bool(GAIN_MIN * expected < of_plain * self.plain_samples())

    def _variances(self) -> tuple[float, float, float]:
        """Return variances of replicates: of plain samples, of half the chains and of all of them.

        They are those of cells relative to the level, summed over cells.
        """
        plain = self._cells(self.plain.estimate())
        level = 0.5 * (plain.mean(axis=0) + self._whole.mean(axis=0))
        level = np.maximum(level, LEVEL_MIN * level.mean()) + np.finfo(np.float64).tiny
        plain, half, whole = (cells / level for cells in (plain, self._half, self._whole))
        of_plain, of_half, of_whole = (
            float(cells.var(axis=0, ddof=1).sum()) for cells in (plain, half, whole)
        )
        # What chains have not met was not met by half of them either.
        unmet = max(1.0, variance_apart(plain, whole) / of_whole) if of_whole > 0 else 1.0
        return of_plain, unmet * of_half, unmet * of_whole

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


def variance_apart(plain: Array, chains: Array) -> float:
    """Return the chains' variance, summed over cells, by their distance from plain samples.

    Of independent, unbiased replicates ``(replicate, cell)``. In the mean it is their variance, and
    so it is where no chain has met what makes most of it; it may be negative.
    """
    apart = len(plain) * (plain.mean(axis=0) - chains.mean(axis=0)) ** 2
    return float((apart - plain.var(axis=0, ddof=1)).sum())


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
