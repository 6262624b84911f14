"""Plain Monte Carlo over the same problems: what Metropolis is with large steps alone.

Kelemen's weights at ``p_large`` 1 would still mix chains in; here every sample counts as itself.
The state of a run is its sums, so it resumes bit-equal from any pass.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from render.arrays import Array
from render.errors import RenderError
from render.sampling.proposals import LIGHT_SALT, PathSampler
from render.sampling.streams import ROUNDS, Hashed, key


class MonteCarlo:
    """A resumable run of ``lanes`` independent paths per pass, in ``replicates`` groups."""

    def __init__(self, problem: PathSampler, lanes: int, replicates: int, seed: int) -> None:
        """Set up; nothing is traced before ``sample``."""
        self.problem, self.replicates, self.seed = problem, replicates, seed
        self.lane: Any = dr.arange(mi.UInt32, lanes)
        self.group = np.arange(lanes) % replicates
        self.done = 0
        self.sums = np.zeros((replicates, problem.bins, problem.channels))

    def sample(self, count: int) -> None:
        """Take ``count`` large steps in every lane.

        Raises:
            RenderError: when a path returns a value that is not finite.
        """
        for _ in range(count):
            streams, _ = mi.sample_tea_32(self.lane, key(self.seed, 2, self.done), ROUNDS)
            deposits = self.problem.evaluate(Hashed(streams), Hashed(streams ^ LIGHT_SALT))
            dr.eval(deposits)
            for deposit in deposits:
                place = self.group * self.problem.bins + np.array(deposit.bin)
                for c, value in enumerate(deposit.values):
                    values = np.array(value, dtype=np.float64)
                    if not np.isfinite(values).all():
                        raise RenderError("the path sampler returned a non-finite value")
                    paid = np.bincount(place, values, self.sums[..., 0].size)
                    self.sums[..., c] += paid.reshape(self.sums.shape[:2])
            self.done += 1

    def estimate(self) -> Array:
        """Return independent estimates ``(replicate, bin, channel)``."""
        paths = np.bincount(self.group) * self.done
        return np.asarray(self.sums / paths[:, None, None])

    def state(self) -> dict[str, np.ndarray]:
        """Return everything that ``restore`` needs, as arrays."""
        return {"done": np.array(self.done), "sums": self.sums}

    def restore(self, kept: dict[str, np.ndarray]) -> None:
        """Continue from a ``state``."""
        self.done, self.sums = int(kept["done"]), kept["sums"]


def monte_carlo_replicates(
    problem: PathSampler, *, lanes: int, passes: int, replicates: int, seed: int
) -> Array:
    """Return independent estimates ``(replicate, bin, channel)`` from ``lanes * passes`` paths."""
    run = MonteCarlo(problem, lanes, replicates, seed)
    run.sample(passes)
    return run.estimate()
