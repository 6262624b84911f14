"""Chains over a path sampler whose integrals are known."""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType
from typing import Any

import drjit as dr
import numpy as np
import pytest

from render.errors import RenderError
from render.sampling.monte_carlo import monte_carlo_replicates
from render.sampling.proposals import LIGHT_EVENTS, LIGHT_SALT, Splat
from render.sampling.pssmlt import ChainSettings, MarkovChains
from render.sampling.streams import hashed, key

SHARES = [0.2, 0.5, 1.0]


class Analytic:
    """Two splats over ``bins`` bins and two channels, whose integrals are known.

    Uses stored numbers, numbers beyond those, and a number of the second light path.
    """

    stored = (2, 2, 2)
    channels = 2

    def __init__(self, mi: ModuleType, bins: int = 3, brightness: float = 1.0) -> None:
        self.mi, self.bins = mi, bins
        self.brightness = mi.Float(brightness)
        dr.make_opaque(self.brightness)

    def evaluate(self, camera: Any, light: Any) -> list[Splat]:
        mi = self.mi
        x, y, _, _ = camera.event(mi.UInt32(0))
        beyond = camera.event(mi.UInt32(5))[1]
        other = light.event(mi.UInt32(LIGHT_EVENTS + 1))[2]
        scale = self.brightness * self.bins
        narrow = scale * x**8 * (1.0 + beyond)
        split = dr.select(x < 0.5, 4.0 * other * scale, 0.0)
        return [
            Splat(self.bin(y), [narrow, split]),
            Splat(self.bin(other), [0.1 * x * scale, dr.zeros(mi.Float, dr.width(x))]),
        ]

    def bin(self, number: Any) -> Any:
        return dr.minimum(self.mi.UInt32(number * self.bins), self.bins - 1)

    @property
    def integrals(self) -> np.ndarray:
        """Return the true values ``(bin, channel)``."""
        return np.tile([1.5 / 9 + 0.05, 1.0], (self.bins, 1))


@pytest.fixture
def run(mono: ModuleType) -> Callable[..., MarkovChains]:
    def start(bins: int = 3, **settings: Any) -> MarkovChains:
        chosen = {"chains": 512, "luminance_samples": 16384, "replicates": 16, **settings}
        chains = MarkovChains(Analytic(mono, bins), ChainSettings(**chosen))
        chains.bootstrap(np.ones((bins, 2)) / bins)
        return chains

    return start


def score(estimate: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Return the distance from the truth in standard errors."""
    error = estimate.std(axis=0, ddof=1) / np.sqrt(len(estimate))
    return np.abs(estimate.mean(axis=0) - truth) / error


@pytest.mark.parametrize("p_large", SHARES)
def test_chains_find_known_integrals_in_every_bin_and_channel(
    mono: ModuleType, run: Callable[..., MarkovChains], p_large: float
) -> None:
    chains = run(p_large=p_large)
    chains.sample(64)
    estimate = chains.estimate()
    truth = chains.sampler.integrals
    assert (score(estimate, truth) < 4).all()
    np.testing.assert_allclose(estimate.mean(axis=0), truth, rtol=0.1)


def test_the_target_may_prefer_bins_without_changing_the_result(
    mono: ModuleType,
) -> None:
    chains = MarkovChains(Analytic(mono), ChainSettings(512, 16384, 0.3, 16, 4))
    chains.bootstrap(np.array([[10.0, 0.0], [1.0, 0.1], [0.01, 3.0]]))
    chains.sample(64)
    assert (score(chains.estimate(), chains.sampler.integrals) < 4).all()


def test_large_steps_alone_agree_with_plain_monte_carlo(
    mono: ModuleType, run: Callable[..., MarkovChains]
) -> None:
    chains = run(p_large=1.0)
    chains.sample(32)
    plain = monte_carlo_replicates(Analytic(mono), lanes=4096, passes=8, replicates=16, seed=3)
    both = np.concatenate([chains.estimate(), plain])
    assert (score(plain, chains.sampler.integrals) < 4).all()
    spread = np.sqrt((chains.estimate().var(axis=0, ddof=1) + plain.var(axis=0, ddof=1)) / 16)
    difference = both[:16].mean(axis=0) - both[16:].mean(axis=0)
    assert (np.abs(difference) < 4 * spread).all()


def test_the_pilot_is_an_estimate_of_the_integrals(run: Callable[..., MarkovChains]) -> None:
    chains = run()
    np.testing.assert_allclose(chains.pilot(), chains.sampler.integrals, rtol=0.15)


def test_the_normalization_comes_with_an_error_bar_that_shrinks_as_large_steps_are_made(
    run: Callable[..., MarkovChains],
) -> None:
    chains = run()
    truth = chains.sampler.integrals.mean(axis=0).sum()
    before = chains.normalization()
    chains.sample(48)
    after = chains.normalization()
    assert abs(before[0] - truth) < 4 * before[1]
    assert abs(after[0] - truth) < 4 * after[1]
    assert after[1] < before[1]


def test_estimates_of_the_normalization_from_elsewhere_count_by_their_worth(
    run: Callable[..., MarkovChains],
) -> None:
    chains = run()
    before = chains.normalization()[0]
    samples = chains.moments[:, 0].copy()
    means = np.full(16, 3 * before)
    for worth, share in ((samples, 1 / 2), (2 * samples, 1 / 2)):
        expected = (1 - share) * chains.normalization()[0] + share * 3 * before
        chains.add_estimates(means, worth)
        assert chains.normalization()[0] == pytest.approx(expected)


def test_the_stated_interval_covers_the_truth_about_as_often_as_it_says(
    run: Callable[..., MarkovChains],
) -> None:
    covered = []
    for seed in range(6):
        chains = run(bins=24, seed=seed, replicates=8)
        chains.sample(16)
        # 2.365 is the 97.5 % quantile of Student's t with 7 degrees of freedom.
        covered.append(score(chains.estimate(), chains.sampler.integrals) < 2.365)
    assert 0.90 <= np.mean(covered) <= 0.99


def test_a_chain_remembers_the_path_that_it_stands_on(
    mono: ModuleType, run: Callable[..., MarkovChains]
) -> None:
    chains = run()
    chains.sample(8)
    memory = [np.array(array).reshape(chains.slots, -1) for array in chains.memory]

    class Remembered:
        def __init__(self, first: int, block: int, stride: int, salt: int) -> None:
            self.first, self.block, self.stride, self.salt = first, block, stride, salt

        def event(self, index: Any) -> tuple[Any, ...]:
            path, within = divmod(int(index[0]), self.stride)
            if within < self.block:
                slot = self.first + path * self.block + within
                return tuple(mono.Float(array[slot]) for array in memory)
            return hashed((chains.tail ^ self.salt, index))[0]

    camera, _, light = chains.sampler.stored
    splats = chains.sampler.evaluate(
        Remembered(0, camera, 1 << 20, 0), Remembered(camera, light, LIGHT_EVENTS, LIGHT_SALT)
    )
    for current, again in zip(chains.current, splats, strict=True):
        np.testing.assert_array_equal(np.array(current.bin), np.array(again.bin))
        for a, b in zip(current.values, again.values, strict=True):
            np.testing.assert_allclose(np.array(a), np.array(b), rtol=1e-6)


def test_a_run_that_is_resumed_from_its_state_ends_bit_equal(
    mono: ModuleType, run: Callable[..., MarkovChains]
) -> None:
    unbroken = run()
    unbroken.sample(8)
    kept = {name: array.copy() for name, array in unbroken.state().items()}
    unbroken.sample(8)
    resumed = MarkovChains(Analytic(mono), unbroken.settings)
    resumed.restore(kept)
    resumed.sample(8)
    np.testing.assert_array_equal(resumed.estimate(), unbroken.estimate())
    assert resumed.normalization() == unbroken.normalization()


def test_seeds_give_different_runs_and_the_same_seed_the_same_run(
    run: Callable[..., MarkovChains],
) -> None:
    estimates = []
    for seed in (1, 1, 2):
        chains = run(seed=seed)
        chains.sample(2)
        estimates.append(chains.estimate())
    np.testing.assert_array_equal(estimates[0], estimates[1])
    assert (estimates[0] != estimates[2]).any()


def test_keys_differ_for_every_seed_purpose_and_index(mono: ModuleType) -> None:
    keys = {int(key(s, p, i)[0]) for s in range(8) for p in range(4) for i in range(8)}
    assert len(keys) == 8 * 4 * 8


def test_a_bootstrap_without_light_says_which_setting_to_raise(mono: ModuleType) -> None:
    chains = MarkovChains(Analytic(mono, brightness=0.0), ChainSettings(512, 1024, 0.3, 8, 1))
    with pytest.raises(RenderError, match="luminance_samples") as caught:
        chains.bootstrap(np.ones((3, 2)))
    assert caught.value.field == "luminance_samples"


def test_a_sampler_that_returns_nan_is_refused(mono: ModuleType) -> None:
    chains = MarkovChains(
        Analytic(mono, brightness=float("nan")), ChainSettings(512, 1024, 0.3, 8, 1)
    )
    with pytest.raises(RenderError, match="non-finite"):
        chains.bootstrap(np.ones((3, 2)))


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("chains", 4),
        ("luminance_samples", 0),
        ("p_large", 0.0),
        ("p_large", 1.5),
        ("p_large", float("nan")),
        ("replicates", 1),
    ],
)
def test_a_setting_out_of_range_is_named(field: str, value: float) -> None:
    with pytest.raises(RenderError, match=field) as caught:
        ChainSettings(**{field: value})
    assert caught.value.field == field
