"""Spread and conformal intervals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from surrogate.training.conformal import (
    Comparison,
    compare,
    conformal,
    counts_spread,
    coverage,
    fit_spread,
    independent_number,
)
from surrogate.training.evaluation import HeldOutEvaluation, random_designs

SHAPE = (4, 6, 2, 3, 5)
MODEL = 0.05


def _evaluation(
    seed: int, noise: float = 0.0, designs: int = 300
) -> tuple[HeldOutEvaluation, np.ndarray]:
    """Return held-out designs and a prediction: cells off by 5 %, the reference by ``noise``."""
    rng = np.random.default_rng(seed)
    truth = rng.uniform(1.0, 2.0, SHAPE)
    guess = truth * (1 + MODEL * rng.standard_normal(SHAPE))
    known = np.ones(SHAPE, dtype=bool)
    chosen = random_designs(designs, known[..., 0, 0, 0], np.zeros(len(known), dtype=int), rng)
    evaluation = HeldOutEvaluation(
        reference=truth * (1 + noise * rng.standard_normal(SHAPE)),
        error=noise * truth,
        reliable=known,
        designs=chosen,
        exposure=5.0,
        lam=10.0,
        held_out=known[..., 0, 0],
        bends=np.arange(2),
    )
    return evaluation, guess


def _compare(evaluation: HeldOutEvaluation, guess: np.ndarray) -> Comparison:
    found = compare(evaluation, guess, _spread(evaluation, guess), np.random.default_rng(9))
    return replace(found, distinct=np.inf)


def _spread(evaluation: HeldOutEvaluation, guess: np.ndarray) -> np.ndarray:
    return counts_spread(evaluation, guess, np.zeros((1, *SHAPE)), np.full(SHAPE[:4], MODEL))


def _table(seed: int, lamps: int) -> Comparison:
    """Compare 60 designs of few lamps that do not turn, whose cells are off by 5 %."""
    rng, shape = np.random.default_rng(seed), (1, lamps, 1, 15, 11)
    truth = np.random.default_rng(99).uniform(1.0, 2.0, shape)
    common = rng.standard_normal((1, lamps, 1, 1, 1))
    guess = truth * (1.0 + MODEL * (common + rng.standard_normal(shape)) / np.sqrt(2.0))
    known = np.ones(shape, dtype=bool)
    evaluation = HeldOutEvaluation(
        reference=truth,
        error=0.2 * MODEL * truth,
        reliable=known,
        designs=random_designs(60, known[..., 0, 0, 0], np.zeros(1, dtype=int), rng),
        exposure=5.0,
        lam=10.0,
        held_out=known[..., 0, 0],
        bends=np.arange(1),
    )
    none, cells = np.zeros((1, *shape)), np.full(shape[:4], MODEL)
    spread = counts_spread(evaluation, guess, none, cells)
    return compare(evaluation, guess, spread, np.random.default_rng(1))


def test_the_spread_is_found_below_the_noise_of_the_reference() -> None:
    rng = np.random.default_rng(0)
    z = rng.normal(size=50_000)
    model, noise = np.exp(-3.0 + 0.4 * z), 0.1
    error = np.hypot(model, noise) * rng.standard_normal(z.shape)
    found = fit_spread(error, np.full(z.shape, noise), np.zeros(z.shape), z)
    assert found == pytest.approx((-3.0, 0.4), abs=0.12)


@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_intervals_cover_nine_of_ten_of_designs_they_have_not_seen(noise: float) -> None:
    found = [
        coverage(
            _compare(*_evaluation(10 + seed, noise)), conformal(_compare(*_evaluation(seed, noise)))
        )
        for seed in range(4)
    ]
    assert np.mean([f.counts for f in found]) == pytest.approx(0.9, abs=0.02)
    assert np.mean([f.score for f in found]) == pytest.approx(0.9, abs=0.05)


def test_a_noisy_reference_does_not_widen_the_intervals() -> None:
    clean, noisy = (conformal(_compare(*_evaluation(3, noise))) for noise in (0.0, 0.05))
    assert noisy.counts == pytest.approx(clean.counts, rel=0.1)
    assert noisy.score < 1.5 * clean.score


def test_the_conformal_quantile_is_that_of_the_finite_sample() -> None:
    found = _compare(*_evaluation(0, designs=9))
    quantiles = conformal(found)
    # ceil((9 + 1) 0.9) = 9: the largest of nine.
    assert quantiles.score == pytest.approx(np.abs(found.score_error).max())


def test_disagreement_and_residual_add_in_quadrature() -> None:
    evaluation, guess = _evaluation(2, designs=5)
    apart = 0.1 * np.array([1.0, -1.0])[:, None, None, None, None, None] * np.ones(SHAPE)
    cell = np.full(SHAPE[:4], 0.05)
    together, shared, alone = (
        counts_spread(evaluation, guess, a, c)
        for a, c in ((apart, cell), (apart, 0 * cell), (0 * apart, cell))
    )
    np.testing.assert_allclose(together**2, shared**2 + alone**2)
    unclipped = replace(evaluation, exposure=1.0)
    total = unclipped.counts(guess)
    np.testing.assert_allclose(
        counts_spread(unclipped, guess, apart, 0 * cell), np.sqrt(2) * 0.1 * total
    )


@pytest.mark.parametrize(("noise", "known", "kept"), [(0.3, 0.02, True), (0.0, 0.02, False)])
def test_renders_that_are_noisier_than_the_preview_leave_its_interval(
    noise: float, known: float, kept: bool
) -> None:
    found = _compare(*_evaluation(5, noise))
    plain, told = conformal(found), conformal(found, known)
    assert (told.score == pytest.approx(known)) is kept
    assert (told == plain) is not kept
    assert told.counts == plain.counts
    # Of renders in which everything is noise, a quarter of it would be held against the model.
    assert not kept or plain.score > 5 * known


def test_designs_of_few_scores_do_not_narrow_an_interval_below_what_noise_tells() -> None:
    # Three lamps have five scores, whatever the number of designs: each is off by a common error,
    # which renders of this noise do not show.
    rng, held = np.random.default_rng(8), []
    for _ in range(400):
        model, noise = 1.0 * rng.standard_normal(5), 3.0
        seen = model + noise * rng.standard_normal(5)
        pick = rng.integers(0, 5, 300)
        off, quiet = seen[pick], np.full(300, noise)
        found = Comparison(off, np.ones(300), quiet, off, quiet)
        held.append(
            [np.abs(model[pick]) <= conformal(found, known).score for known in (None, 1.645)]
        )
    by_designs, by_sensors = np.mean(held, axis=2).T
    # A few of the 2,000 errors of deviation 1 lie beyond 1.645 of it; of hardly a sensor most do.
    assert 0.87 < by_sensors.mean() < 0.93
    assert (by_sensors < 0.5).mean() < 0.02 < (by_designs < 0.5).mean()


def test_independent_scores_are_counted_whatever_the_number_of_designs() -> None:
    rng = np.random.default_rng(4)
    mixed = rng.standard_normal((5, 300))

    found = [independent_number(rng.standard_normal((16, 5)) @ mixed) for _ in range(200)]
    # Five scores of nearly equal weight in 300 designs; one alone; as many as there are draws.
    assert np.median(found) == pytest.approx(5.0, rel=0.15)
    assert independent_number(np.outer(rng.standard_normal(16), mixed[0])) == pytest.approx(1.0)
    assert independent_number(rng.standard_normal((16, 10_000))) > 14.0
    assert independent_number(np.ones((16, 4))) == np.inf


def test_errors_that_are_drawn_anew_are_held_though_lamps_are_few() -> None:
    held = []
    for seed in range(60):
        few = _table(seed, 4)
        new = _table(1000 + seed, 4)
        off = np.abs(new.score_error)
        held.append(
            [
                np.mean(off <= conformal(replace(few, distinct=distinct)).score)
                for distinct in (np.inf, few.distinct)
            ]
        )
    by_designs, by_scores = np.mean(held, axis=0)
    assert by_designs < 0.8
    assert 0.85 < by_scores < 0.97


def test_renders_whose_noise_hides_the_scores_refute_nothing() -> None:
    rng = np.random.default_rng(9)
    noise = np.full(200, 2.0)
    # Error bars of few light paths are too short: what noise does looks like an error of the model.
    error = 20.0 * rng.standard_normal(200)
    found = Comparison(error, np.ones(200), noise, error, noise)
    assert conformal(found, 3.0).score > 30.0
    hidden = conformal(replace(found, noise_share=0.8), 3.0)
    assert hidden.score == pytest.approx(3.0)
    # As many samples as bring a share of 0.8 to 0.4.
    assert hidden.effort == pytest.approx((0.4**-2 - 1.0) / (0.8**-2 - 1.0))
    assert conformal(replace(found, noise_share=0.3), 3.0) == conformal(found, 3.0)


def test_renders_that_say_less_than_the_preview_ask_for_the_samples_that_would_say_more() -> None:
    rng = np.random.default_rng(9)
    noise = np.full(200, 4.0)
    error = noise * rng.standard_normal(200)
    found = conformal(Comparison(error, np.ones(200), noise, error, noise), 3.0)
    assert found.effort == pytest.approx((1.645 * 4.0 / 3.0) ** 2)
    less = noise / np.sqrt(1.01 * found.effort)
    again = conformal(Comparison(error, np.ones(200), less, 0.1 * error, less), 3.0)
    assert again.effort == 1.0


def test_renders_refute_the_interval_of_a_preview_that_is_far_off() -> None:
    rng = np.random.default_rng(9)
    noise = np.full(200, 2.0)
    for off, refuted in ((0.0, False), (20.0, True)):
        error = off + noise * rng.standard_normal(200)
        found = Comparison(error, np.ones(200), noise, error, noise)
        assert (conformal(found, 3.0) == conformal(found)) is refuted
        assert conformal(found, 3.0).score >= (off if refuted else 3.0) - 1e-9
