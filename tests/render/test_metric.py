"""The metric and the score: closed forms, invariances, extremes, and numpy against torch."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from render.errors import TableError
from render.metric import (
    MetricConfig,
    choose_exposure,
    choose_lambda,
    clipped_fraction,
    design_score,
    image_counts,
    metric_terms,
    pairwise_metric,
    score_terms,
    site_metric,
)

Array = NDArray[np.float64]
SHAPE = (4, 2, 3, 6)  # fiber, bend, site, facet

transports = arrays(np.float64, SHAPE, elements=st.floats(0.0, 50.0))
powers = arrays(np.float64, (SHAPE[0], 3), elements=st.floats(0.0, 1.0))
# Above 1e-290, so that the smallest factor below keeps every digit: subnormals have fewer.
counts_arrays = arrays(np.float64, (2, 3, 6, 3), elements=st.just(0.0) | st.floats(1e-290, 255.0))
quick = settings(max_examples=40, deadline=None, derandomize=True)


def score_of(counts: Array, lam: float = 20.0) -> float:
    return float(design_score(site_metric(counts, lam)).score)


def random_case(seed: int = 0) -> tuple[Array, Array]:
    rng = np.random.default_rng(seed)
    return 30.0 * rng.random(SHAPE), rng.random((SHAPE[0], 3))


def test_metric_of_a_hand_computed_site() -> None:
    counts = np.array([[3.0, 4.0, 0.0], [0.0, 0.0, 15.0]])
    intensity, hue = metric_terms(counts)
    assert intensity == pytest.approx(10.0 - 5.0)
    assert hue == pytest.approx(np.sqrt(2.0))  # both neighbor steps are equal: no spread
    assert site_metric(counts, 3.0) == pytest.approx(5.0 + 3.0 * np.sqrt(2.0))


def test_the_score_is_the_sum_of_its_terms() -> None:
    transport, power = random_case()
    counts = image_counts(transport, power, 2.0)
    terms = score_terms(counts, 20.0)
    assert terms.sum() == pytest.approx(score_of(counts))
    intensity, hue = metric_terms(counts)
    assert terms[:2].sum() == pytest.approx(intensity.mean())
    assert terms[2:4].sum() == pytest.approx(20.0 * hue.mean())
    assert (np.sign(terms) == [1, -1, 1, -1, -1, -1]).all()


def test_score_of_a_hand_computed_map() -> None:
    parts = design_score(np.array([[1.0, 3.0], [5.0, 7.0]]))
    assert (parts.mean, parts.spread_sites, parts.spread_bends) == (4.0, 1.0, 2.0)
    assert parts.score == 1.0


def test_pairwise_metric_equals_the_plain_double_loop() -> None:
    counts = 255.0 * np.random.default_rng(1).random((5, 3))
    pairs = [np.linalg.norm(a - b) for a, b in itertools.permutations(counts, 2)]
    assert pairwise_metric(counts) == pytest.approx(np.mean(pairs) - np.std(pairs))


@quick
@given(counts_arrays, st.permutations([0, 1, 2]))
def test_permuting_the_colors_changes_nothing(counts: Array, order: list[int]) -> None:
    assert score_of(counts[..., order]) == pytest.approx(score_of(counts), abs=1e-9)


@quick
@given(counts_arrays, st.integers(0, 5))
def test_turning_the_indenter_changes_nothing(counts: Array, shift: int) -> None:
    assert score_of(np.roll(counts, shift, axis=-2)) == pytest.approx(score_of(counts), abs=1e-9)


@quick
@given(counts_arrays, st.floats(1e-3, 1.0))
def test_exposure_scales_intensity_and_leaves_hue(counts: Array, factor: float) -> None:
    intensity, hue = metric_terms(counts)
    dimmed_intensity, dimmed_hue = metric_terms(factor * counts)
    np.testing.assert_allclose(dimmed_intensity, factor * intensity, atol=1e-9)
    np.testing.assert_allclose(dimmed_hue, hue, atol=1e-9)


@quick
@given(transports, powers, powers)
def test_images_of_two_lightings_add_up(transport: Array, first: Array, second: Array) -> None:
    loose = MetricConfig(count_max=np.inf)
    both = image_counts(transport, first + second, 0.1, loose)
    apart = image_counts(transport, first, 0.1, loose) + image_counts(transport, second, 0.1, loose)
    np.testing.assert_allclose(both, apart, atol=1e-9)


@quick
@given(transports, powers)
def test_counts_stay_within_the_camera_range(transport: Array, power: Array) -> None:
    counts = image_counts(transport, power, 20.0)
    assert counts.min() >= 0.0
    assert counts.max() <= 255.0


def test_batches_are_independent() -> None:
    cases = [random_case(seed) for seed in range(3)]
    transport, power = (np.stack(part) for part in zip(*cases, strict=True))
    together = image_counts(transport, power, 2.0)
    for index, case in enumerate(cases):
        np.testing.assert_allclose(together[index], image_counts(*case, 2.0))


def test_black_facets_have_no_hue_and_no_nan() -> None:
    assert score_of(np.zeros((2, 3, 6, 3))) == 0.0
    one_black = np.ones((6, 3))
    one_black[2] = 0.0
    _, hue = metric_terms(one_black)
    steps = np.array([0.0, 1.0, 1.0, 0.0, 0.0, 0.0])
    assert hue == pytest.approx(steps.mean() - steps.std())


def test_nan_reaches_the_score() -> None:
    transport, power = random_case()
    transport[1, 0, 2, 3] = np.nan
    counts = image_counts(transport, power, 2.0)
    assert np.isnan(counts[0, 2, 3]).all()
    metric = site_metric(counts, 20.0)
    assert np.isnan(metric).sum() == 1
    assert np.isnan(design_score(metric).score)


def test_spreads_are_population_spreads_and_the_convention_can_be_changed() -> None:
    metric = np.random.default_rng(2).random((3, 5))
    sample = design_score(metric, MetricConfig(ddof=1))
    assert design_score(metric).spread_sites == pytest.approx(metric.mean(0).std())
    assert sample.spread_sites == pytest.approx(metric.mean(0).std(ddof=1))
    with pytest.raises(TableError, match="ddof = 1 is undefined"):
        design_score(metric[:1], MetricConfig(ddof=1))


def test_an_open_ring_of_facets_has_one_step_less() -> None:
    counts = np.eye(3)[[0, 0, 1]]
    _, hue = metric_terms(counts, MetricConfig(cyclic=False))
    steps = np.array([0.0, np.sqrt(2.0)])
    assert hue == pytest.approx(steps.mean() - steps.std())


def test_float32_keeps_a_small_spread_on_a_bright_facet() -> None:
    counts = np.full((1, 1, 10, 3), 200.0)
    counts[..., 0] += 2.9e-3 * np.arange(10)
    intensity, _ = metric_terms(counts.astype(np.float32))
    norm = np.linalg.norm(counts.astype(np.float32).astype(np.float64), axis=-1)
    assert intensity.dtype == np.float32
    spread = np.linalg.norm(counts, axis=-1).mean() - float(intensity[0, 0])
    assert spread == pytest.approx(norm.std(), abs=1e-4)


@pytest.mark.parametrize("scale", [1e-15, 1e-3, 1.0, 255.0])
def test_float32_agrees_with_float64_over_many_decades(scale: float) -> None:
    counts = scale * np.random.default_rng(3).random((2, 3, 10, 3))
    exact = metric_terms(counts)
    rounded = metric_terms(counts.astype(np.float32))
    np.testing.assert_allclose(rounded[0], exact[0], rtol=1e-4)
    np.testing.assert_allclose(rounded[1], exact[1], rtol=1e-4)


def test_numpy_and_torch_agree() -> None:
    torch = pytest.importorskip("torch")
    transport, power = random_case()
    tensor = image_counts(torch.tensor(transport), torch.tensor(power), 12.0)
    counts = image_counts(transport, power, 12.0)
    np.testing.assert_allclose(tensor.numpy(), counts, rtol=1e-14)
    np.testing.assert_allclose(
        design_score(site_metric(tensor, 20.0)).score, score_of(counts), rtol=1e-13
    )
    np.testing.assert_allclose(pairwise_metric(tensor), pairwise_metric(counts), rtol=1e-13)
    assert float(clipped_fraction(tensor)) == pytest.approx(float(clipped_fraction(counts)))


def test_torch_derivatives_are_finite_at_black_and_equal_facets() -> None:
    torch = pytest.importorskip("torch")
    counts = torch.zeros((1, 3, 6, 3), dtype=torch.float64)
    counts[0, 1] = 100.0
    counts.requires_grad_()
    design_score(site_metric(counts, 20.0)).score.backward()
    assert torch.isfinite(counts.grad).all()


def test_clipped_facets_are_counted() -> None:
    counts = np.zeros((1, 2, 5, 3))
    counts[0, 0, 1, 2] = 255.0
    assert clipped_fraction(counts) == pytest.approx(0.1)


def test_exposure_puts_the_baseline_percentile_at_230_counts() -> None:
    radiance = np.random.default_rng(4).random((3, 15, 10, 3))
    exposed = choose_exposure(radiance, 1) * radiance[1]
    assert np.percentile(exposed, 99.5) == pytest.approx(230.0)
    with pytest.raises(TableError, match="allowed: finite and at least 1e-12"):
        choose_exposure(np.zeros((1, 1, 3, 3)))


def test_lambda_gives_both_terms_the_same_weight() -> None:
    counts = np.tile(200.0 * np.eye(3)[[0, 1, 2, 0, 1, 2]] + 20.0, (2, 3, 1, 1))
    lam = choose_lambda(counts)
    intensity, hue = metric_terms(counts)
    assert intensity.mean() == pytest.approx(lam * hue.mean())
    with pytest.raises(TableError, match="different colors"):
        choose_lambda(np.ones((1, 1, 6, 3)))
    dim = np.zeros((1, 1, 6, 3))
    dim[0, 0, 0] = 230.0, 0.0, 0.0
    with pytest.raises(TableError, match="83% of its facets have less than 1 count: widen the"):
        choose_lambda(dim)
