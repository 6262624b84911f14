"""Integrals over the unknown power agree with closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from hw.check.sweep_check import PowerFits, around_one, between


@pytest.mark.parametrize("best", [0.7, 1.0, 1.2])
@pytest.mark.parametrize("spread", [0.001, 0.05, 0.3])
def test_a_normal_prior_gives_the_normal_evidence(best: float, spread: float) -> None:
    prior = 0.08
    fit = PowerFits(np.array([best]), np.array([spread]), np.array([0.0]))
    both = np.hypot(prior, spread)
    exact = np.log(spread / both) - 0.5 * ((best - 1) / both) ** 2
    assert fit.evidence(around_one(prior))[0] == pytest.approx(exact, abs=0.05)


def test_a_narrow_likelihood_inside_a_uniform_prior_has_its_own_area() -> None:
    fit = PowerFits(np.array([0.5]), np.array([0.001]), np.array([0.0]))
    exact = np.log(0.001 * np.sqrt(2 * np.pi) / 0.8)
    assert fit.evidence(between(0.05, 0.85))[0] == pytest.approx(exact, abs=0.01)


def test_a_prior_far_away_is_improbable_but_not_impossible() -> None:
    fit = PowerFits(np.array([1.0]), np.array([0.01]), np.array([0.0]))
    evidence = fit.evidence(between(0.0, 0.5))[0]
    assert np.isfinite(evidence)
    assert evidence < -1000
