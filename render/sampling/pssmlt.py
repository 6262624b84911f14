"""Running the chains: bootstrap of the normalization, mutations, accumulation, error bars.

All random numbers are counter-based and sums are made in a fixed order, so a run that was
interrupted and resumed from its state ends bit-equal to an unbroken one.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from render.arrays import Array
from render.errors import RenderError
from render.sampling.monte_carlo import add_splat
from render.sampling.proposals import MutatedStream, Mutation, PathSampler, Splat
from render.sampling.streams import key, tea, uniform
from render.steady_registry import steady_registry


@dataclass(frozen=True)
class ChainSettings:
    """Parameters of a Metropolis run, named as in Mitsuba 0.6 where it has them.

    Arguments:
        chains: number of Markov chains, run side by side.
        luminance_samples: bootstrap samples, for the normalization ``b`` and the chains' starts.
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
                raise RenderError(f"{name} = {value:g}, allowed: {low:g} to {high:g}", field=name)


class MarkovChains:
    """A resumable Metropolis run over one path sampler."""

    def __init__(self, sampler: PathSampler, settings: ChainSettings) -> None:
        """Set the chains up; nothing is traced before ``bootstrap`` or ``restore``."""
        self.sampler, self.settings = sampler, settings
        camera, paths, light = sampler.stored
        self.slots = camera + paths * light
        self.lane = dr.arange(mi.UInt32, settings.chains)
        self.memory = [dr.zeros(mi.Float, self.slots * settings.chains) for _ in range(4)]
        self.group = np.arange(settings.chains) % settings.replicates
        self.done = 0
        self.sums = np.zeros((settings.replicates, sampler.bins, sampler.channels))
        # Of large steps and bootstrap samples per replicate: count, sum of F, sum of F^2.
        self.moments = np.zeros((settings.replicates, 3))
        self.weights: Array = np.ones((sampler.bins, sampler.channels))

    # -- start ---------------------------------------------------------------------------------

    @steady_registry()
    def pilot(self) -> Array:
        """Return a plain Monte Carlo estimate ``(bin, channel)`` from half the bootstrap."""
        total = np.zeros_like(self.sums)
        for batch in range(self._batches()):
            splats, _ = self._independent(2 * batch + 1)
            for splat in splats:
                add_splat(total, self.group, splat)
        return np.asarray(total.sum(axis=0) / (self._batches() * self.settings.chains))

    @steady_registry()
    def bootstrap(self, weights: Array, samples: int | None = None) -> None:
        """Fix the target's weights ``(bin, channel)``, estimate ``b`` and start the chains.

        Kelemen 2002, sec. 4.1, from so many ``samples``; half of ``luminance_samples`` where they
        are not given.

        Raises:
            RenderError: when no bootstrap path carries light, or one is not finite.
        """
        replicates = self.settings.replicates
        self.weights = np.asarray(weights, dtype=np.float64)
        target, seeds = [], []
        batches = self._batches() if samples is None else max(1, samples // self.settings.chains)
        for batch in range(batches):
            splats, seed = self._independent(2 * batch)
            target.append(np.array(self._target(splats), dtype=np.float64))
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
                )
            self.moments[r] = len(f), f.sum(), (f**2).sum()
            lanes = np.nonzero(self.group == r)[0]
            # Systematic resampling: chains start in the stationary density, no burn-in.
            edges = np.cumsum(f) / f.sum()
            at = (np.arange(len(lanes)) + rng.random()) / len(lanes)
            chosen[lanes] = members[np.minimum(np.searchsorted(edges, at), len(f) - 1)]
        # Gathered: NumPy's own memory is read by other kernels, where it is not aligned.
        self._start_from(dr.gather(mi.UInt32, mi.UInt32(starts), mi.UInt32(chosen)))

    def add_estimates(self, means: Array, samples: Array | float) -> None:
        """Add estimates ``(replicate,)`` of ``b``, each worth so many plain samples."""
        self.moments[:, 0] += samples
        self.moments[:, 1] += samples * means

    def normalization(self) -> tuple[float, float]:
        """Return ``b``, from all plain samples so far, and its standard error."""
        means = self.moments[:, 1] / self.moments[:, 0]
        return float(means.mean()), float(means.std(ddof=1) / np.sqrt(len(means)))

    def _start_from(self, seed: mi.UInt32) -> None:
        """Set every chain's state to the path of a bootstrap seed."""
        mutation = Mutation.all_large(seed)
        self.current = self._proposed(mutation)
        self.current_target = self._target(self.current)
        self.current_weight = dr.zeros(mi.Float, self.settings.chains)
        self.memory = self._moved_memory(mutation, mutation.large)
        self.tail = seed
        dr.eval(self.current_target, self.tail, self.memory)

    # -- mutations -----------------------------------------------------------------------------

    @steady_registry()
    def sample(self, count: int) -> None:
        """Propose ``count`` mutations in every chain; ``b`` is brought up to date once."""
        b = mi.Float((self.moments[:, 1] / self.moments[:, 0]).astype(np.float32))
        p_large = mi.Float(self.settings.p_large)
        dr.make_opaque(b, p_large)
        mean = dr.gather(mi.Float, b, self.lane % self.settings.replicates)
        for _ in range(count):
            # ------------------------------ Propose a path -------------------------
            now = key(self.settings.seed, 3, self.done)
            a, fresh, step, c = tea([self.lane, now, self.lane ^ 0x5BD1E995, now])
            mutation = Mutation(uniform(a) < p_large, fresh, step, self.tail)
            proposed = self._proposed(mutation)
            target = self._target(proposed)
            ratio = dr.select(self.current_target > 0, target / self.current_target, 1.0)
            acceptance = dr.minimum(ratio, 1.0)
            # ------------------- Weights of both (Kelemen 2002, sec. 4.3) ----------
            large = dr.select(mutation.large, 1.0, 0.0)
            proposed_weight = (acceptance + large) / (target / mean + p_large)
            rejected = (1.0 - acceptance) / (self.current_target / mean + p_large)
            current_weight = self.current_weight + rejected
            accepted = uniform(c) < acceptance
            # What leaves a chain is splatted: the old state when it is replaced, else the
            # proposal that was turned down.
            leaving = dr.select(accepted, self.current, proposed)
            leaving_weight = dr.select(accepted, current_weight, proposed_weight)
            self.current = dr.select(accepted, proposed, self.current)
            self.current_weight = dr.select(accepted, proposed_weight, current_weight)
            self.current_target = dr.select(accepted, target, self.current_target)
            dr.eval(leaving, self.current, leaving_weight, self.current_weight,
                    self.current_target, accepted, target, mutation.large, fresh, step)  # fmt: skip
            self.memory = self._moved_memory(mutation, accepted)
            self.tail = dr.select(accepted & mutation.large, fresh, self.tail)
            dr.eval(self.memory, self.tail)
            # ------------------------------ Accumulate -----------------------------
            for splat in leaving:
                add_splat(self.sums, self.group, splat, np.array(leaving_weight, dtype=np.float64))
            self._count(np.array(target, dtype=np.float64), np.array(mutation.large))
            self.done += 1

    def _count(self, target: Array, large: np.ndarray) -> None:
        """Add the large steps, which are plain samples of F, to the estimate of ``b``."""
        if not np.isfinite(target).all():
            raise RenderError("the path sampler returned a non-finite value")
        plain = np.where(large, target, 0.0)
        for column, values in enumerate((large.astype(np.float64), plain, plain**2)):
            self.moments[:, column] += np.bincount(self.group, values, self.settings.replicates)

    def estimate(self) -> Array:
        """Return the estimates ``(replicate, bin, channel)``, states still in chains included."""
        total = self.sums.copy()
        for splat in self.current:
            add_splat(total, self.group, splat, np.array(self.current_weight, dtype=np.float64))
        mutations = np.bincount(self.group, minlength=self.settings.replicates) * self.done
        return np.asarray(total / mutations[:, None, None])

    def largest(self) -> Array:
        """Return what the largest replicate adds to the mean, ``(bin, channel)``.

        Samples of one chain are correlated: only replicates stand for themselves.
        """
        return np.asarray(self.estimate().max(axis=0) / self.settings.replicates)

    # -- interruption --------------------------------------------------------------------------

    def state(self) -> dict[str, np.ndarray]:
        """Return everything that ``restore`` needs, as arrays."""
        state: dict[str, np.ndarray] = {
            "done": np.array(self.done),
            "sums": self.sums,
            "plain": self.moments,
            "weights": self.weights,
            "tail": np.array(self.tail),
            "carried": np.array(self.current_weight),
            "target": np.array(self.current_target),
        }
        for i, memory in enumerate(self.memory):
            state[f"memory{i}"] = np.array(memory)
        for i, splat in enumerate(self.current):
            state[f"bin{i}"] = np.array(splat.bin)
            state[f"values{i}"] = np.stack([np.array(value) for value in splat.values])
        return state

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Continue from a ``state``; the run then ends bit-equal to an unbroken one."""
        self.done = int(state["done"])
        self.sums, self.moments, self.weights = state["sums"], state["plain"], state["weights"]
        self.tail, self.current_weight = mi.UInt32(state["tail"]), mi.Float(state["carried"])
        self.current_target = mi.Float(state["target"])
        self.memory = [mi.Float(state[f"memory{i}"]) for i in range(4)]
        splats = sum(name.startswith("bin") for name in state)
        self.current = [
            Splat(mi.UInt32(state[f"bin{i}"]), [mi.Float(row) for row in state[f"values{i}"]])
            for i in range(splats)
        ]

    # -- pieces --------------------------------------------------------------------------------

    def _batches(self) -> int:
        return max(1, self.settings.luminance_samples // (2 * self.settings.chains))

    def _independent(self, batch: int) -> tuple[list[Splat], mi.UInt32]:
        """Return the splats and seeds of one batch of independent paths."""
        seed, _ = tea([self.lane, key(self.settings.seed, 1, batch)])
        return self._proposed(Mutation.all_large(seed)), seed

    def _proposed(self, mutation: Mutation) -> list[Splat]:
        """Return the evaluated splats of proposals.

        Whatever they are made of is in memory, so that all steps share kernels, the first too.
        """
        dr.make_opaque(mutation, self.memory, self.lane)
        splats = self.sampler.evaluate(*self._streams(mutation))
        dr.eval(splats)
        return splats

    def _target(self, splats: list[Splat]) -> mi.Float:
        """Return F of the splats."""
        weight = mi.Float(self.weights.astype(np.float32).ravel())
        total = mi.Float(0.0)
        for splat in splats:
            for c, value in enumerate(splat.values):
                index = splat.bin * self.sampler.channels + c
                total += value * dr.gather(mi.Float, weight, index)
        return total

    def _streams(self, mutation: Mutation) -> tuple[MutatedStream, MutatedStream]:
        """Return the proposal's primary samples of camera and light subpaths."""
        camera, paths, light = self.sampler.stored
        memory = (self.memory, self.lane, self.settings.chains)
        return (
            MutatedStream.camera(*memory, mutation, camera),
            MutatedStream.light(*memory, mutation, camera, light, paths),
        )

    def _moved_memory(self, mutation: Mutation, accepted: mi.Bool) -> list[mi.Float]:
        """Return the chains' memory with accepted proposals written into it."""
        chains = self.settings.chains
        everywhere = dr.arange(mi.UInt32, self.slots * chains)
        slot = everywhere // chains
        lane = everywhere - slot * chains
        camera, light = self._streams(dr.gather(Mutation, mutation, lane))
        camera.lane = light.lane = lane
        from_camera = slot < camera.block
        numbers_camera = camera.slot_numbers(dr.select(from_camera, slot, 0))
        numbers_light = light.slot_numbers(dr.select(from_camera, 0, slot - camera.block))
        moved = dr.gather(mi.Bool, accepted, lane)
        return [
            dr.select(moved, dr.select(from_camera, a, b), old)
            for a, b, old in zip(numbers_camera, numbers_light, self.memory, strict=True)
        ]
