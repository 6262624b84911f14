"""The jackknife removes the bias that noise puts on the score, and its error bars are honest."""

from __future__ import annotations

import numpy as np
import pytest

from optimize.scoring import jackknife
from render.errors import RenderError

CELLS = np.linspace(1.0, 2.0, 24).reshape(4, 6)


def mean_minus_spread(cells: np.ndarray) -> float:
    """Return a score shaped like eq. (4.7): the mean minus a population standard deviation."""
    return float(cells.mean() - cells.std())


def noisy(rng: np.random.Generator, replicates: int, sigma: float) -> np.ndarray:
    """Return independent noisy copies of CELLS, ``(replicate, 4, 6)``."""
    return CELLS + sigma * rng.standard_normal((replicates, *CELLS.shape))


def test_a_linear_statistic_is_left_alone() -> None:
    data = noisy(np.random.default_rng(1), 6, 0.3)
    result = jackknife(lambda cells: float(cells.mean()), data)
    means = data.mean(axis=(1, 2))
    assert result.value == pytest.approx(means.mean(), rel=1e-12)
    assert result.se == pytest.approx(means.std(ddof=1) / np.sqrt(6), rel=1e-9)


def test_noise_biases_the_score_downwards_and_the_jackknife_removes_that() -> None:
    rng = np.random.default_rng(2)
    results = [jackknife(mean_minus_spread, noisy(rng, 6, 0.4)) for _ in range(800)]
    truth = mean_minus_spread(CELLS)
    plain_bias = np.mean([r.plain for r in results]) - truth
    left = np.mean([r.value for r in results]) - truth
    assert plain_bias < -0.02
    assert abs(left) < 0.2 * abs(plain_bias)


def test_the_interval_covers_the_truth_as_often_as_it_says() -> None:
    rng = np.random.default_rng(3)
    truth = mean_minus_spread(CELLS)
    hits = 0
    for _ in range(600):
        low, high = jackknife(mean_minus_spread, noisy(rng, 5, 0.2)).interval()
        hits += low <= truth <= high
    assert hits / 600 == pytest.approx(0.95, abs=0.04)


def test_common_noise_cancels_in_a_joint_difference() -> None:
    rng = np.random.default_rng(4)
    shared = noisy(rng, 5, 0.2)
    pair = np.stack([shared, 1.1 * shared], axis=1)

    def difference(both: np.ndarray) -> float:
        return mean_minus_spread(both[1]) - mean_minus_spread(both[0])

    joint = jackknife(difference, pair)
    alone = jackknife(mean_minus_spread, shared)
    assert joint.se == pytest.approx(0.1 * alone.se, rel=1e-6)


def test_one_replicate_is_refused_because_it_has_no_error_bar() -> None:
    with pytest.raises(RenderError, match="at least 2 seeds"):
        jackknife(mean_minus_spread, CELLS[None])
