"""Plain Monte Carlo over the same path samplers: what Metropolis is with large steps alone.

Kelemen's weights at ``p_large`` 1 would still mix chains in; here every sample counts as itself.
The state of a run is its sums, so it resumes bit-equal from any pass.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from render.arrays import Array
from render.errors import RenderError
from render.sampling.proposals import LIGHT_SALT, CellSplat, PathSampler, Splat
from render.sampling.streams import HashedStream, key, tea
from render.steady_registry import steady_registry


class MonteCarlo:
    """A resumable run of ``lanes`` independent paths per pass, in ``replicates`` groups."""

    def __init__(self, sampler: PathSampler, lanes: int, replicates: int, seed: int) -> None:
        """Set up; nothing is traced before ``sample``."""
        self.sampler, self.replicates, self.seed = sampler, replicates, seed
        self.lane = dr.arange(mi.UInt32, lanes)
        self.group = np.arange(lanes) % replicates
        self.done = 0
        self.sums = np.zeros((replicates, sampler.bins, sampler.channels))
        self.highest = np.zeros((sampler.bins, sampler.channels))

    @steady_registry()
    def sample(self, count: int) -> None:
        """Take ``count`` samples in every lane.

        Raises:
            RenderError: when a path returns a value that is not finite.
        """
        for _ in range(count):
            splats, _ = independent_paths(self.sampler, self.lane, key(self.seed, 2, self.done))
            for splat in splats:
                if isinstance(splat, CellSplat):
                    self._add_to_all(splat.values)
                    continue
                add_splat(self.sums, self.group, splat)
                bins = np.array(splat.bin)
                for c, values in enumerate(finite_values(splat)):
                    np.maximum.at(self.highest[:, c], bins, values)
            self.done += 1

    def _add_to_all(self, values: Array) -> None:
        """Add ``values (bin, channel, lane)``, lane by lane."""
        if not np.isfinite(values).all():
            raise RenderError("the path sampler returned a non-finite value")
        for group in range(self.replicates):
            self.sums[group] += values[..., group :: self.replicates].sum(axis=-1)
        np.maximum(self.highest, values.max(axis=-1), out=self.highest)

    def estimate(self) -> Array:
        """Return independent estimates ``(replicate, bin, channel)``."""
        paths = np.bincount(self.group) * self.done
        return np.asarray(self.sums / paths[:, None, None])

    def largest(self) -> Array:
        """Return what the largest contribution adds to the mean, ``(bin, channel)``."""
        return np.asarray(self.highest / (self.done * dr.width(self.lane)))

    def state(self) -> dict[str, np.ndarray]:
        """Return everything that ``restore`` needs, as arrays."""
        return {"done": np.array(self.done), "sums": self.sums, "highest": self.highest}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Continue from a ``state``."""
        self.done = int(state["done"])
        self.sums, self.highest = state["sums"], state["highest"]


def independent_paths(
    sampler: PathSampler, lane: mi.UInt32, salt: mi.UInt32
) -> tuple[list[Splat], mi.UInt32]:
    """Return the evaluated splats of one independent path per lane, and the lanes' seeds.

    ``salt`` tells passes apart.
    """
    seed, _ = tea([lane, salt])
    splats = sampler.evaluate(HashedStream(seed), HashedStream(seed ^ LIGHT_SALT))
    dr.eval(splats, seed)
    return splats, seed


def finite_values(splat: Splat) -> list[Array]:
    """Return the values of a splat per channel, as float64.

    Raises:
        RenderError: when one of them is not finite.
    """
    values = [np.array(value, dtype=np.float64) for value in splat.values]
    if not all(np.isfinite(value).all() for value in values):
        raise RenderError("the path sampler returned a non-finite value")
    return values


def add_splat(sums: Array, group: np.ndarray, splat: Splat, weight: Array | float = 1.0) -> None:
    """Add a splat times ``weight`` to ``sums`` ``(group, bin, channel)``, lane by lane.

    ``group`` is that of each lane.

    Raises:
        RenderError: when a value is not finite.
    """
    place = group * sums.shape[1] + np.array(splat.bin)
    for c, values in enumerate(finite_values(splat)):
        total = np.bincount(place, values * weight, sums[..., 0].size)
        sums[..., c] += total.reshape(sums.shape[:2])


def monte_carlo_replicates(
    sampler: PathSampler, *, lanes: int, passes: int, replicates: int, seed: int
) -> Array:
    """Return independent estimates ``(replicate, bin, channel)`` from ``lanes * passes`` paths."""
    run = MonteCarlo(sampler, lanes, replicates, seed)
    run.sample(passes)
    return run.estimate()
