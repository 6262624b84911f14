"""Running the chains: bootstrap of the luminance scale, mutations, accumulation, error bars.

All random numbers are counter-based and sums are made in a fixed order, so a run that was
interrupted and resumed from its state ends bit-equal to an unbroken one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from render.arrays import Array
from render.errors import RenderError
from render.sampling.proposals import LIGHT_SALT, Chosen, PathSampler, Proposed, Splat
from render.sampling.streams import ROUNDS, Hashed, key, uniform


@dataclass(frozen=True)
class ChainSettings:
    """Parameters of a Metropolis run, named as in Mitsuba 0.6 where it has them.

    Arguments:
        chains: number of Markov chains, run side by side.
        luminance_samples: bootstrap samples, for the scale ``b`` and the chains' starts.
        p_large: probability of a large step.
        replicates: independent groups of chains, for error bars.
        seed: of all random numbers.
    """

    chains: int = 16384
    luminance_samples: int = 100_000
    p_large: float = 0.3
    replicates: int = 8
    seed: int = 1

    def __post_init__(self) -> None:
        """Check the ranges.

        Raises:
            RenderError: names the parameter that is out of range.
        """
        allowed = {
            "chains": (self.replicates, 1 << 22),
            "luminance_samples": (1, 1 << 34),
            "p_large": (1e-3, 1.0),
            "replicates": (2, 4096),
        }
        for name, (low, high) in allowed.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise RenderError(
                    f"{name} = {value:g}, allowed: {low:g} to {high:g}", field=name, value=value
                )


class MarkovChains:
    """A resumable Metropolis run over one problem."""

    def __init__(self, problem: PathSampler, settings: ChainSettings) -> None:
        """Set the chains up; nothing is traced before ``bootstrap`` or ``restore``."""
        self.problem, self.settings = problem, settings
        camera, paths, light = problem.stored
        self.slots = camera + paths * light
        self.lane: Any = dr.arange(mi.UInt32, settings.chains)
        self.group = np.arange(settings.chains) % settings.replicates
        self.done = 0
        self.sums = np.zeros((settings.replicates, problem.bins, problem.channels))
        # Large steps and bootstrap samples per replicate: count, sum of F, sum of F^2.
        self.plain = np.zeros((settings.replicates, 3))
        self.weights: Array = np.ones((problem.bins, problem.channels))

    # -- start ---------------------------------------------------------------------------------

    def pilot(self) -> Array:
        """Return a plain Monte Carlo estimate ``(bin, channel)`` from half the bootstrap."""
        total = np.zeros_like(self.sums)
        for batch in range(self._batches()):
            deposits, _ = self._independent(2 * batch + 1)
            for deposit in deposits:
                self._pay(total, deposit, np.ones(self.settings.chains))
        return np.asarray(total.sum(axis=0) / (self._batches() * self.settings.chains))

    def bootstrap(self, weights: Array, samples: int | None = None) -> None:
        """Fix the target's weights ``(bin, channel)``, estimate ``b`` and start the chains.

        From so many ``samples``; half of ``luminance_samples`` where they are not given.

        Raises:
            RenderError: when no bootstrap path carries light, or one is not finite.
        """
        replicates = self.settings.replicates
        self.weights = np.asarray(weights, dtype=np.float64)
        target, seeds = [], []
        batches = self._batches() if samples is None else max(1, samples // self.settings.chains)
        for batch in range(batches):
            deposits, seed = self._independent(2 * batch)
            target.append(np.array(self._target(deposits), dtype=np.float64))
            seeds.append(np.array(seed))
        values, starts = np.concatenate(target), np.concatenate(seeds)
        group = np.tile(self.group, batches)
        chosen = np.zeros(self.settings.chains, dtype=np.int64)
        rng = np.random.Generator(np.random.PCG64([self.settings.seed, 7]))
        for r in range(replicates):
            members = np.nonzero(group == r)[0]
            f = values[members]
            if not np.isfinite(f).all():
                raise RenderError("the path sampler returned a non-finite value in the bootstrap")
            if not f.sum() > 0:
                raise RenderError(
                    f"luminance_samples = {self.settings.luminance_samples}: no path of the "
                    "bootstrap carries light; raise it, or check that a light reaches the camera",
                    field="luminance_samples",
                    value=self.settings.luminance_samples,
                )
            self.plain[r] = len(f), f.sum(), (f**2).sum()
            lanes = np.nonzero(self.group == r)[0]
            # Systematic resampling: chains start in the stationary density, no burn-in.
            edges = np.cumsum(f) / f.sum()
            at = (np.arange(len(lanes)) + rng.random()) / len(lanes)
            chosen[lanes] = members[np.minimum(np.searchsorted(edges, at), len(f) - 1)]
        self._start_from(mi.UInt32(starts[chosen]))

    def inform(self, means: Array, worth: Array | float) -> None:
        """Add estimates ``(replicate,)`` of the mean of F, each worth so many plain samples."""
        self.plain[:, 0] += worth
        self.plain[:, 1] += worth * means

    def scale(self) -> tuple[float, float]:
        """Return the mean of F, from all plain samples so far, and its standard error."""
        means = self.plain[:, 1] / self.plain[:, 0]
        return float(means.mean()), float(means.std(ddof=1) / np.sqrt(len(means)))

    def _start_from(self, seed: Any) -> None:
        """Set every chain's state to the path of a bootstrap seed."""
        always = dr.full(mi.Bool, True, self.settings.chains)
        self.memory = [dr.zeros(mi.Float, self.slots * self.settings.chains) for _ in range(4)]
        chosen = Chosen(large=always, fresh=seed, step=seed, tail=seed)
        self.current = self.problem.evaluate(*self._proposed(chosen))
        self.current_target = self._target(self.current)
        self.carried = dr.zeros(mi.Float, self.settings.chains)
        self.memory = self._moved_memory(chosen, always)
        self.tail = seed
        dr.eval(self.current, self.current_target, self.tail, self.memory)

    # -- mutations -----------------------------------------------------------------------------

    def sample(self, count: int) -> None:
        """Propose ``count`` mutations in every chain; the scale is brought up to date once."""
        b = mi.Float((self.plain[:, 1] / self.plain[:, 0]).astype(np.float32))
        p_large = mi.Float(self.settings.p_large)
        dr.make_opaque(b, p_large)
        mean = dr.gather(mi.Float, b, self.lane % self.settings.replicates)
        for _ in range(count):
            now = key(self.settings.seed, 3, self.done)
            a, fresh = mi.sample_tea_32(self.lane, now, ROUNDS)
            step, c = mi.sample_tea_32(self.lane ^ 0x5BD1E995, now, ROUNDS)
            chosen = Chosen(uniform(a) < p_large, fresh, step, self.tail)
            proposed = self.problem.evaluate(*self._proposed(chosen))
            target = self._target(proposed)
            ratio = dr.select(self.current_target > 0, target / self.current_target, 1.0)
            acceptance = dr.minimum(ratio, 1.0)
            large = dr.select(chosen.large, 1.0, 0.0)
            worth = (acceptance + large) / (target / mean + p_large)
            carried = self.carried + (1.0 - acceptance) / (self.current_target / mean + p_large)
            accepted = uniform(c) < acceptance
            # What leaves a chain is paid out: the old state when it is replaced, else the
            # proposal that was turned down.
            pairs = list(zip(proposed, self.current, strict=True))
            leaving = [old.where(accepted, new) for new, old in pairs]
            self.current = [new.where(accepted, old) for new, old in pairs]
            payment = dr.select(accepted, carried, worth)
            self.carried = dr.select(accepted, worth, carried)
            self.current_target = dr.select(accepted, target, self.current_target)
            dr.eval(leaving, self.current, payment, self.carried, self.current_target,
                    accepted, target, chosen.large, fresh, step)  # fmt: skip
            self.memory = self._moved_memory(chosen, accepted)
            self.tail = dr.select(accepted & chosen.large, fresh, self.tail)
            dr.eval(self.memory, self.tail)
            for deposit in leaving:
                self._pay(self.sums, deposit, np.array(payment, dtype=np.float64))
            self._count(np.array(target, dtype=np.float64), np.array(chosen.large))
            self.done += 1

    def _count(self, target: Array, large: np.ndarray) -> None:
        """Add the large steps, which are plain samples of F, to the estimate of the scale."""
        if not np.isfinite(target).all():
            raise RenderError("the path sampler returned a non-finite value")
        plain = np.where(large, target, 0.0)
        for column, values in enumerate((large.astype(np.float64), plain, plain**2)):
            self.plain[:, column] += np.bincount(self.group, values, self.settings.replicates)

    def estimate(self) -> Array:
        """Return the estimates ``(replicate, bin, channel)``, states still in chains included."""
        total = self.sums.copy()
        for deposit in self.current:
            self._pay(total, deposit, np.array(self.carried, dtype=np.float64))
        mutations = np.bincount(self.group, minlength=self.settings.replicates) * self.done
        return np.asarray(total / mutations[:, None, None])

    # -- interruption --------------------------------------------------------------------------

    def state(self) -> dict[str, np.ndarray]:
        """Return everything that ``restore`` needs, as arrays."""
        kept: dict[str, np.ndarray] = {
            "done": np.array(self.done),
            "sums": self.sums,
            "plain": self.plain,
            "weights": self.weights,
            "tail": np.array(self.tail),
            "carried": np.array(self.carried),
            "target": np.array(self.current_target),
        }
        for i, memory in enumerate(self.memory):
            kept[f"memory{i}"] = np.array(memory)
        for i, deposit in enumerate(self.current):
            kept[f"bin{i}"] = np.array(deposit.bin)
            kept[f"values{i}"] = np.stack([np.array(value) for value in deposit.values])
        return kept

    def restore(self, kept: dict[str, np.ndarray]) -> None:
        """Continue from a ``state``; the run then ends bit-equal to an unbroken one."""
        self.done = int(kept["done"])
        self.sums, self.plain, self.weights = kept["sums"], kept["plain"], kept["weights"]
        self.tail, self.carried = mi.UInt32(kept["tail"]), mi.Float(kept["carried"])
        self.current_target = mi.Float(kept["target"])
        self.memory = [mi.Float(kept[f"memory{i}"]) for i in range(4)]
        deposits = sum(name.startswith("bin") for name in kept)
        self.current = [
            Splat(mi.UInt32(kept[f"bin{i}"]), [mi.Float(row) for row in kept[f"values{i}"]])
            for i in range(deposits)
        ]

    # -- pieces --------------------------------------------------------------------------------

    def _batches(self) -> int:
        return max(1, self.settings.luminance_samples // (2 * self.settings.chains))

    def _independent(self, batch: int) -> tuple[list[Splat], Any]:
        """Return the deposits and seeds of one batch of independent paths."""
        seed, _ = mi.sample_tea_32(self.lane, key(self.settings.seed, 1, batch), ROUNDS)
        deposits = self.problem.evaluate(Hashed(seed), Hashed(seed ^ LIGHT_SALT))
        dr.eval(deposits, seed)
        return deposits, seed

    def _target(self, deposits: list[Splat]) -> Any:
        """Return F of the deposits."""
        weight = mi.Float(self.weights.astype(np.float32).ravel())
        total = mi.Float(0.0)
        for deposit in deposits:
            for c, value in enumerate(deposit.values):
                index = deposit.bin * self.problem.channels + c
                total += value * dr.gather(mi.Float, weight, index)
        return total

    def _pay(self, sums: Array, deposit: Splat, worth: Array) -> None:
        """Add deposits times ``worth`` to ``sums`` ``(replicate, bin, channel)``, lane by lane."""
        place = self.group * self.problem.bins + np.array(deposit.bin)
        for c, value in enumerate(deposit.values):
            paid = np.bincount(place, np.array(value, dtype=np.float64) * worth,
                               sums.shape[0] * sums.shape[1])  # fmt: skip
            sums[:, :, c] += paid.reshape(sums.shape[:2])

    def _proposed(self, chosen: Chosen) -> tuple[Proposed, Proposed]:
        camera, paths, light = self.problem.stored
        memory = (self.memory, self.lane, self.settings.chains)
        return (
            Proposed.camera(*memory, chosen, camera),
            Proposed.light(*memory, chosen, camera, light, paths),
        )

    def _moved_memory(self, chosen: Chosen, accepted: Any) -> list[Any]:
        """Return the chains' memory with accepted proposals written into it."""
        chains = self.settings.chains
        everywhere = dr.arange(mi.UInt32, self.slots * chains)
        slot = everywhere // chains
        lane = everywhere - slot * chains
        camera, light = self._proposed(chosen.spread(lane))
        camera.lane = light.lane = lane
        from_camera = slot < camera.block
        numbers_camera = camera.slot_numbers(dr.select(from_camera, slot, 0))
        numbers_light = light.slot_numbers(dr.select(from_camera, 0, slot - camera.block))
        moved = dr.gather(mi.Bool, accepted, lane)
        return [
            dr.select(moved, dr.select(from_camera, a, b), old)
            for a, b, old in zip(numbers_camera, numbers_light, self.memory, strict=True)
        ]
