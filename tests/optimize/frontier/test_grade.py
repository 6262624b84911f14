"""Errors of a level against a noisy reference."""

from __future__ import annotations

import numpy as np
import pytest

from optimize.frontier.grade import grade, noise_row, score_of
from optimize.frontier.reference import Reference

DESIGNS, LAM = 40, 30.0


@pytest.fixture
def truth() -> np.ndarray:
    """Return counts ``(design, bend, site, facet, 3)`` whose scores differ well."""
    rng = np.random.default_rng(0)
    bright = rng.uniform(0.3, 1.0, (DESIGNS, 1, 1, 1, 1))
    return rng.uniform(30, 200, (DESIGNS, 2, 4, 6, 3)) * bright


def reference(counts: np.ndarray, noise: float, seed: int = 1) -> Reference:
    rng = np.random.default_rng(seed)
    error = noise * counts
    noisy = counts + error * rng.standard_normal(counts.shape)
    scores = score_of(counts, LAM)
    return Reference(noisy, error, scores, np.full(DESIGNS, 0.5), 1.0, LAM, 100, 8, 60.0)


def test_a_perfect_level_has_no_errors_against_an_exact_reference(truth: np.ndarray) -> None:
    row = grade(reference(truth, 0.0), "perfect", truth, seconds=0.5, setup=2.0)
    assert row.facet_error_median == row.facet_error_p95 == row.facet_error_true == 0.0
    assert row.score_error == 0.0
    assert row.kendall_tau == 1.0
    assert (row.seconds_per_design, row.setup_seconds, row.designs) == (0.5, 2.0, DESIGNS)


def test_noise_of_the_reference_is_taken_out_of_the_true_error(truth: np.ndarray) -> None:
    noisy = reference(truth, 0.05)
    perfect = grade(noisy, "perfect", truth, seconds=1.0)
    assert perfect.facet_error_median > 0.02
    assert perfect.facet_error_true < 0.015
    off = grade(noisy, "3 % too bright", 1.03 * truth, seconds=1.0)
    assert off.facet_error_true == pytest.approx(0.03, abs=0.008)


def test_the_noise_row_is_what_a_perfect_level_shows(truth: np.ndarray) -> None:
    noisy = reference(truth, 0.05)
    perfect, floor = grade(noisy, "perfect", truth, seconds=1.0), noise_row(noisy, 0)
    assert floor.facet_error_median == pytest.approx(perfect.facet_error_median, rel=0.05)


def test_a_level_that_ranks_backwards_has_a_tau_of_minus_one(truth: np.ndarray) -> None:
    exact = reference(truth, 0.0)
    row = grade(exact, "backwards", truth, seconds=1.0, scores=-exact.scores)
    assert row.kendall_tau == -1.0
    assert row.kendall_tau_interval == (-1.0, -1.0)


def test_the_interval_of_tau_holds_it_and_narrows_with_better_ranks(truth: np.ndarray) -> None:
    exact = reference(truth, 0.0)
    rng = np.random.default_rng(2)
    widths = []
    for spread in (0.05, 1.0):
        scores = exact.scores + spread * exact.scores.std() * rng.standard_normal(DESIGNS)
        row = grade(exact, "noisy ranks", truth, seconds=1.0, scores=scores)
        low, high = row.kendall_tau_interval
        assert low <= row.kendall_tau <= high
        widths.append(high - low)
    assert widths[0] < widths[1]
