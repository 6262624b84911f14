"""Running the chains: bootstrap of the luminance scale, mutations, accumulation, error bars.

All random numbers are counter-based and all sums are integers, so a run that was interrupted and
resumed from its state ends bit-equal to an unbroken one, on any number of threads.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from render.bending import Array
from render.chains import Deposit, Problem, Proposed
from render.errors import RenderError
from render.primary import ROUNDS, Hashed, uniform

# Sums are kept in units of 2^-32 of a bin's expected value: exact, order-free addition.
QUANTUM = 2.0**32
# One deposit may be worth this many expected bin values; more would overflow the sums.
DEPOSIT_MAX = 2.0**28


@dataclass(frozen=True)
class Settings:
    """Parameters of a Metropolis run, named as in Mitsuba 0.6 where it has them.

    Arguments:
        chains: number of Markov chains, run side by side.
        luminance_samples: bootstrap samples, for the scale ``b`` and the chains' starts.
        p_large: probability of a large step.
        replicates: independent groups of chains, for error bars.
        seed: of all random numbers.
    """

    chains: int = 16384
    luminance_samples: int = 262144
    p_large: float = 0.3
    replicates: int = 8
    seed: int = 1


class Chains:
    """A resumable Metropolis run over one problem."""

    def __init__(self, problem: Problem, settings: Settings) -> None:
        """Set the chains up; nothing is traced before ``bootstrap`` or ``restore``."""
        self.problem, self.settings = problem, settings
        camera, paths, light = problem.stored
        self.slots = camera + paths * light
        self.lane = dr.arange(mi.UInt32, settings.chains)
        self.group = self.lane % settings.replicates
        self.done = 0
        size = settings.replicates * problem.bins * problem.channels
        self.sums = np.zeros(size, dtype=np.int64)
        self.large = np.zeros((settings.replicates, 3))  # count, sum of F, sum of F^2
        self.weights: Array = np.ones((problem.bins, problem.channels))

    # -- start ---------------------------------------------------------------------------------

    def pilot(self) -> Array:
        """Return a plain Monte Carlo estimate ``(bin, channel)`` from half the bootstrap."""
        total = np.zeros(self.problem.bins * self.problem.channels)
        for batch in range(self._batches()):
            deposits, _ = self._plain(2 * batch + 1)
            total += self._scatter_plain(deposits)
        mean = total / (self._batches() * self.settings.chains)
        return mean.reshape(self.problem.bins, self.problem.channels)

    def bootstrap(self, weights: Array) -> None:
        """Fix the target's weights ``(bin, channel)``, estimate ``b`` and start the chains.

        Raises:
            RenderError: when no bootstrap path carries light.
        """
        self.weights = np.asarray(weights, dtype=np.float64)
        target, seeds = [], []
        weight = mi.Float(self.weights.astype(np.float32).ravel())
        for batch in range(self._batches()):
            deposits, seed = self._plain(2 * batch)
            target.append(np.array(self._target(deposits, weight)))
            seeds.append(np.array(seed))
        values, starts = np.concatenate(target).astype(np.float64), np.concatenate(seeds)
        group = np.arange(len(values)) % self.settings.replicates
        chosen = np.zeros(self.settings.chains, dtype=np.int64)
        rng = np.random.Generator(np.random.PCG64([self.settings.seed, 7]))
        for r in range(self.settings.replicates):
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
            self.large[r] = len(f), f.sum(), (f**2).sum()
            lanes = np.nonzero(np.array(self.group) == r)[0]
            # Systematic resampling: chains start in the stationary density, no burn-in.
            edges = np.cumsum(f) / f.sum()
            at = (np.arange(len(lanes)) + rng.random()) / len(lanes)
            chosen[lanes] = members[np.minimum(np.searchsorted(edges, at), len(f) - 1)]
        self._start_from(mi.UInt32(starts[chosen]))

    def _start_from(self, seed: Any) -> None:
        """Set every chain's state to the path of a bootstrap seed."""
        camera, light = self._proposed(seed, seed, seed, dr.full(mi.Bool, True, dr.width(seed)))
        deposits = self.problem.evaluate(camera, light)
        weight = mi.Float(self.weights.astype(np.float32).ravel())
        self.current = deposits
        self.current_target = self._target(deposits, weight)
        self.carried = dr.zeros(mi.Float, self.settings.chains)
        self.tail = seed
        self.memory = [dr.zeros(mi.Float, self.slots * self.settings.chains) for _ in range(4)]
        self.memory = self._moved_memory(
            seed, seed, seed, dr.full(mi.Bool, True, self.settings.chains),
            dr.full(mi.Bool, True, self.settings.chains),
        )  # fmt: skip
        dr.eval(self.current, self.current_target, self.tail, self.memory)

    # -- mutations -----------------------------------------------------------------------------

    def mutate(self, count: int) -> None:
        """Propose ``count`` mutations in every chain."""
        settings = self.settings
        weight = mi.Float(self.weights.astype(np.float32).ravel())
        b = mi.Float((self.large[:, 1] / self.large[:, 0]).astype(np.float32))
        p_large = mi.Float(settings.p_large)
        dr.make_opaque(weight, b, p_large)
        size = len(self.sums)
        large_count = np.zeros(settings.replicates)
        large_sum = np.zeros(settings.replicates)
        large_square = np.zeros(settings.replicates)
        sums = dr.zeros(mi.Int64, size)
        for _ in range(count):
            key = mi.UInt32(self._key(3, self.done))
            dr.make_opaque(key)
            a, fresh = mi.sample_tea_32(self.lane, key, ROUNDS)
            step, c = mi.sample_tea_32(self.lane ^ 0x5BD1E995, key, ROUNDS)
            large = uniform(a) < p_large
            camera, light = self._proposed(fresh, step, self.tail, large)
            deposits = self.problem.evaluate(camera, light)
            target = self._target(deposits, weight)
            mean = dr.gather(mi.Float, b, self.group)
            ratio = dr.select(self.current_target > 0, target / self.current_target, 1.0)
            acceptance = dr.minimum(ratio, 1.0)
            worth = (acceptance + dr.select(large, 1.0, 0.0)) / (target / mean + p_large)
            carried = self.carried + (1.0 - acceptance) / (self.current_target / mean + p_large)
            accepted = uniform(c) < acceptance
            # What leaves the chain is paid out: the old state when it is replaced, else the
            # proposal that was turned down.
            for new, old in zip(deposits, self.current, strict=True):
                self._pay(
                    sums,
                    dr.select(accepted, old.bin, new.bin),
                    [dr.select(accepted, x, y) for x, y in zip(old.values, new.values, strict=True)],
                    dr.select(accepted, carried, worth),
                )
                old.bin = dr.select(accepted, new.bin, old.bin)
                old.values = [
                    dr.select(accepted, y, x) for x, y in zip(old.values, new.values, strict=True)
                ]
            self.carried = dr.select(accepted, worth, carried)
            self.current_target = dr.select(accepted, target, self.current_target)
            plain = dr.select(large, target, 0.0)
            dr.eval(sums, self.current, self.carried, self.current_target, accepted, plain, large,
                    fresh, step)  # fmt: skip
            self.memory = self._moved_memory(fresh, step, self.tail, large, accepted)
            self.tail = dr.select(accepted & large, fresh, self.tail)
            dr.eval(self.memory, self.tail)
            values, flags = np.array(plain).astype(np.float64), np.array(large)
            group = np.array(self.group)
            large_count += np.bincount(group, flags, settings.replicates)
            large_sum += np.bincount(group, values, settings.replicates)
            large_square += np.bincount(group, values**2, settings.replicates)
            self.done += 1
        self.sums += np.array(sums)
        self.large += np.stack([large_count, large_sum, large_square], axis=1)

    def estimate(self) -> Array:
        """Return the estimates ``(replicate, bin, channel)``, states still in chains included."""
        settings, shape = self.settings, (self.problem.bins, self.problem.channels)
        sums = dr.zeros(mi.Int64, len(self.sums))
        for deposit in self.current:
            self._pay(sums, deposit.bin, deposit.values, self.carried)
        total = (self.sums + np.array(sums)) / QUANTUM
        share = np.bincount(np.array(self.group), minlength=settings.replicates) * self.done
        scaled = total.reshape(settings.replicates, *shape) / share[:, None, None]
        return scaled / self.weights

    # -- interruption --------------------------------------------------------------------------

    def state(self) -> dict[str, np.ndarray]:
        """Return everything that ``restore`` needs, as arrays."""
        kept = {
            "done": np.int64(self.done),
            "sums": self.sums,
            "large": self.large,
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
        self.sums, self.large, self.weights = kept["sums"], kept["large"], kept["weights"]
        self.tail, self.carried = mi.UInt32(kept["tail"]), mi.Float(kept["carried"])
        self.current_target = mi.Float(kept["target"])
        self.memory = [mi.Float(kept[f"memory{i}"]) for i in range(4)]
        deposits = sum(name.startswith("bin") for name in kept)
        self.current = [
            Deposit(mi.UInt32(kept[f"bin{i}"]), [mi.Float(row) for row in kept[f"values{i}"]])
            for i in range(deposits)
        ]

    # -- pieces --------------------------------------------------------------------------------

    def _batches(self) -> int:
        return max(1, self.settings.luminance_samples // (2 * self.settings.chains))

    def _key(self, purpose: int, index: int) -> int:
        word = self.settings.seed * 0x9E3779B97F4A7C15 + purpose * 0xBF58476D1CE4E5B9
        word = (word ^ (word >> 31)) + index * 0x94D049BB133111EB
        return ((word ^ (word >> 29)) * 0xD6E8FEB86659FD93 >> 32) & 0xFFFFFFFF

    def _plain(self, batch: int) -> tuple[Any, Any]:
        """Return the deposits and seeds of one batch of independent paths."""
        key = mi.UInt32(self._key(1, batch))
        dr.make_opaque(key)
        seed, _ = mi.sample_tea_32(self.lane, key, ROUNDS)
        deposits = self.problem.evaluate(Hashed(seed), Hashed(seed ^ LIGHT_SALT))
        dr.eval(deposits, seed)
        return deposits, seed

    def _scatter_plain(self, deposits: Any) -> Array:
        sums = dr.zeros(mi.Float64, self.problem.bins * self.problem.channels)
        for deposit in deposits:
            for c, value in enumerate(deposit.values):
                where = deposit.bin * self.problem.channels + c
                dr.scatter_reduce(dr.ReduceOp.Add, sums, mi.Float64(value), where)
        return np.array(sums)

    def _target(self, deposits: Any, weight: Any) -> Any:
        total = mi.Float(0.0)
        for deposit in deposits:
            for c, value in enumerate(deposit.values):
                total += value * dr.gather(mi.Float, weight, deposit.bin * self.problem.channels + c)
        return total

    def _pay(self, sums: Any, where: Any, values: list[Any], worth: Any) -> None:
        weight = mi.Float(self.weights.astype(np.float32).ravel())
        for c, value in enumerate(values):
            index = where * self.problem.channels + c
            scaled = value * worth * dr.gather(mi.Float, weight, index)
            dr.scatter_reduce(
                dr.ReduceOp.Add,
                sums,
                mi.Int64(dr.round(mi.Float64(scaled) * QUANTUM)),
                self.group * (self.problem.bins * self.problem.channels) + index,
            )

    def _proposed(self, fresh: Any, step: Any, tail: Any, large: Any) -> tuple[Any, Any]:
        camera, paths, light = self.problem.stored
        chains = self.settings.chains
        memory = getattr(self, "memory", None) or [dr.zeros(mi.Float, 1) for _ in range(4)]
        common = {"memory": memory, "lane": self.lane, "lanes": chains, "large": large}
        return (
            Proposed(**common, first=0, block=camera, blocks=1, stride=1 << 16,
                     fresh=fresh, step=step, tail=tail),
            Proposed(**common, first=camera, block=light, blocks=paths, stride=LIGHT_EVENTS,
                     fresh=fresh ^ LIGHT_SALT, step=step ^ LIGHT_SALT, tail=tail ^ LIGHT_SALT),
        )  # fmt: skip

    def _moved_memory(self, fresh: Any, step: Any, tail: Any, large: Any, accepted: Any) -> list[Any]:
        """Return the chains' memory with accepted proposals written into it."""
        chains = self.settings.chains
        everywhere = dr.arange(mi.UInt32, self.slots * chains)
        slot = everywhere // chains
        lane = everywhere - slot * chains
        spread = [dr.gather(type(x), x, lane) for x in (fresh, step, tail, large, accepted)]
        camera, light = self._proposed(*spread[:4])
        camera.lane = light.lane = lane
        from_camera = slot < camera.block
        numbers_camera = camera.slot_numbers(dr.select(from_camera, slot, 0))
        numbers_light = light.slot_numbers(dr.select(from_camera, 0, slot - camera.block))
        return [
            dr.select(spread[4], dr.select(from_camera, a, b), old)
            for a, b, old in zip(numbers_camera, numbers_light, self.memory, strict=True)
        ]


LIGHT_SALT = 0x7FEB352D
"""Separates the streams of light and camera subpaths."""
LIGHT_EVENTS = 4096
