"""Plain Monte Carlo keeps the largest contribution to every bin beside its sums."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import drjit as dr
import numpy as np

from render.sampling.monte_carlo import MonteCarlo
from render.sampling.proposals import Splat


class Noted:
    """Splats of a value per channel over ``bins`` bins, which are noted beside."""

    stored = (1, 1, 1)
    bins, channels = 7, 2

    def __init__(self, mi: ModuleType) -> None:
        self.mi = mi
        self.noted: list[tuple[np.ndarray, np.ndarray]] = []

    def evaluate(self, camera: Any, light: Any) -> list[Splat]:
        x, y, z, _ = camera.event(self.mi.UInt32(0))
        values = [dr.rcp(1.0 - x) * self.mi.Float(y > 0.5), z]
        splats = []
        for turn in range(2):
            place = (self.mi.UInt32(y * self.bins) + 3 * turn) % self.bins
            dr.eval(place, values)
            self.noted.append((np.array(place), np.stack([np.array(v) for v in values])))
            splats.append(Splat(place, values))
        return splats


def test_the_largest_contribution_of_every_bin_is_kept_as_its_part_of_the_mean(
    mono: ModuleType,
) -> None:
    sampler = Noted(mono)
    run = MonteCarlo(sampler, 100, 4, 3)
    run.sample(3)
    expected = np.zeros((sampler.bins, sampler.channels))
    for place, values in sampler.noted:
        for b, each in zip(place, values.T, strict=True):
            expected[b] = np.maximum(expected[b], each)
    np.testing.assert_allclose(run.largest(), expected / 300, rtol=1e-6)
    assert (run.largest() <= run.estimate().mean(axis=0) * (1 + 1e-9)).all()


def test_a_run_that_is_resumed_ends_with_the_same_bits(mono: ModuleType) -> None:
    whole, half = (MonteCarlo(Noted(mono), 64, 4, 5) for _ in range(2))
    whole.sample(4)
    half.sample(2)
    resumed = MonteCarlo(Noted(mono), 64, 4, 5)
    resumed.restore({name: array.copy() for name, array in half.state().items()})
    resumed.sample(2)
    np.testing.assert_array_equal(resumed.sums, whole.sums)
    np.testing.assert_array_equal(resumed.largest(), whole.largest())
