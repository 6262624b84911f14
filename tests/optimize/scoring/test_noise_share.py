"""The share of noise in what facets differ by, of transport whose noise is known."""

from __future__ import annotations

import numpy as np
import pytest

from optimize.design import ScoreSettings
from optimize.scoring import noise_doubt, noise_share

SETTINGS = ScoreSettings(exposure=50.0, lam=10.0)
THREE = np.eye(3)
SHAPE = (3, 1, 40, 10)
"""Lamps, bends, sites, facets."""
REPLICATES = 8


def replicates(spread: float, noise: float, seed: int = 0) -> np.ndarray:
    """Return light around 1: facets differ by ``spread``, the mean of replicates by ``noise``."""
    rng = np.random.default_rng(seed)
    truth = 1.0 + spread * rng.standard_normal(SHAPE)
    each = noise * np.sqrt(REPLICATES) * rng.standard_normal((REPLICATES, *SHAPE))
    return np.asarray(truth + each)


@pytest.mark.parametrize("noise", [0.01, 0.03, 0.1])
def test_the_share_is_the_root_of_the_noises_part_of_the_variance(noise: float) -> None:
    found = noise_share(SETTINGS, replicates(0.03, noise), THREE)
    assert found == pytest.approx(noise / np.hypot(0.03, noise), rel=0.05)


def test_facets_that_noise_alone_makes_different_are_all_noise() -> None:
    assert noise_share(SETTINGS, replicates(0.0, 0.02), THREE) == pytest.approx(1.0, abs=0.05)


def test_light_without_noise_has_none_whether_facets_differ_or_not() -> None:
    assert noise_share(SETTINGS, replicates(0.05, 0.0), THREE) == pytest.approx(0.0, abs=1e-6)
    assert noise_share(SETTINGS, np.ones((REPLICATES, *SHAPE)), THREE) == 0.0


def test_one_channel_has_no_hues_to_weigh() -> None:
    light, lit = replicates(0.03, 0.03), np.ones((3, 1))
    assert noise_share(SETTINGS, light, lit) == pytest.approx(np.sqrt(0.5), rel=0.1)


def test_the_samples_asked_for_bring_the_score_below_the_doubt() -> None:
    rough = replicates(0.03, 0.03)
    said = noise_doubt(SETTINGS, rough, THREE, samples=1000)
    assert said.startswith("noise makes 7")
    assert "samples more per cell are needed" in said
    more = float(said.split("about ")[1].split(" samples")[0].replace(",", ""))
    enough = replicates(0.03, 0.03 * np.sqrt(1000 / (1000 + 1.1 * more)))
    assert noise_doubt(SETTINGS, enough, THREE, samples=1000) == ""
    barely = replicates(0.03, 0.03 * np.sqrt(1000 / (1000 + 0.8 * more)))
    assert noise_doubt(SETTINGS, barely, THREE) != ""
