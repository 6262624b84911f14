"""The jackknife removes the bias that noise puts on the score, and its error bars are honest."""

from __future__ import annotations

import numpy as np
import pytest

from optimize.scoring import jackknife, pooled_estimate
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


def steps_of_hue(colors: np.ndarray) -> float:
    """Return a score like M_phi of eq. (4.6), of ``(facet, 3)``: how neighbors differ in hue."""
    hue = colors / np.linalg.norm(colors, axis=-1, keepdims=True)
    steps = np.linalg.norm(np.roll(hue, -1, axis=0) - hue, axis=-1)
    return float(300 * (steps.mean() - steps.std()))


@pytest.mark.parametrize("replicates", [8, 16])
@pytest.mark.parametrize("noise", [0.01, 0.03, 0.06])
def test_facets_of_nearly_one_hue_are_held_as_often_as_the_interval_says(
    noise: float, replicates: int
) -> None:
    """``noise`` is that of the mean; neighbors' hues are 0.014 to 0.062 apart."""
    rng = np.random.default_rng(5)
    angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    colors = np.stack([1 + 0.3 * np.sin(angle), np.ones(24), 1 + 0.2 * np.cos(2 * angle)], axis=-1)
    truth, spread = steps_of_hue(colors), noise * np.sqrt(replicates)
    found = []
    for _ in range(300):
        drawn = rng.gamma(spread**-2, spread**2, (replicates, 24, 3))
        found.append(jackknife(steps_of_hue, colors * drawn))
    held = np.mean([low <= truth <= high for low, high in (f.interval(0.9) for f in found)])
    assert 0.85 < held < 0.995
    one_left_out = [abs(f.pseudo.mean() - truth) < 1.9 * f.sampling for f in found]
    assert noise < 0.06 or np.mean(one_left_out) < held - 0.05


def test_biases_that_cancel_in_halves_are_found_term_by_term() -> None:
    """Noise lifts the mean of steps and their spread, at different rates."""
    rng, held = np.random.default_rng(7), []
    steps = 1.0 + 0.9 * np.sin(np.linspace(0, 2 * np.pi, 120, endpoint=False))
    truth = np.stack([steps, 0.0 * steps], axis=-1)

    def terms(vectors: np.ndarray) -> np.ndarray:
        size = np.linalg.norm(vectors, axis=-1)
        return np.array([size.mean(), -size.std()])

    known = terms(truth).sum()
    for _ in range(200):
        drawn = truth + 0.5 * np.sqrt(8) * rng.standard_normal((8, 120, 2))
        whole, by_term = (
            jackknife(lambda mean: float(terms(mean).sum()), drawn),
            jackknife(terms, drawn),
        )
        assert whole.value == pytest.approx(by_term.value)
        assert whole.sampling == pytest.approx(by_term.sampling)
        assert whole.bias_error <= by_term.bias_error + 1e-12
        intervals = [estimate.interval(0.9) for estimate in (whole, by_term)]
        held.append([low <= known <= high for low, high in intervals])
    of_sum, of_terms = np.mean(held, axis=0)
    assert of_sum < 0.85 < 0.88 < of_terms


def test_errors_of_the_corrections_do_not_average_out_over_runs() -> None:
    rng = np.random.default_rng(6)
    runs = [jackknife(mean_minus_spread, noisy(rng, 8, 0.8)) for _ in range(9)]
    together = pooled_estimate(runs)
    assert together.value == pytest.approx(np.mean([run.value for run in runs]))
    assert together.sampling < 0.5 * np.mean([run.sampling for run in runs])
    assert together.bias_error == pytest.approx(np.mean([run.bias_error for run in runs]))


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


def test_the_difference_of_two_independent_estimates_holds_the_truth_as_often_as_it_says() -> None:
    rng, hits = np.random.default_rng(4), 0
    for _ in range(600):
        one, other = (jackknife(mean_minus_spread, noisy(rng, 8, sigma)) for sigma in (0.1, 0.3))
        low, high = (one - other).interval()
        hits += low <= 0.0 <= high
    assert hits / 600 == pytest.approx(0.95, abs=0.04)
