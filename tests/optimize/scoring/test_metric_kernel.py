"""The compiled metric is the metric, and compiled functions keep NaN."""

from __future__ import annotations

import math

import numpy as np
import pytest

from optimize.scoring.metric_kernel import channel_mark, kernel_constants, score_lanes, vectorized
from render.metric import MetricConfig, clip_counts, design_score, site_metric

CONVENTIONS = [
    MetricConfig(),
    MetricConfig(ddof=1),
    MetricConfig(cyclic=False),
    MetricConfig(count_max=90.0),
]


def vectorized_score(
    base: np.ndarray, block: np.ndarray, bends: int, lam: float, config: MetricConfig
) -> np.ndarray:
    out = np.empty(block.shape[-1], block.dtype)
    mark = channel_mark(base.shape[-1], block.dtype.type)
    score_lanes(base, block, bends, kernel_constants(config, lam, block.dtype), mark, out)
    return out


def plain_score(
    base: np.ndarray, block: np.ndarray, bends: int, lam: float, config: MetricConfig
) -> np.ndarray:
    counts = np.moveaxis(base[..., None] + block, -1, 0).astype(np.float64)
    counts = counts.reshape(len(counts), bends, -1, *counts.shape[2:])
    metric = site_metric(clip_counts(counts, config), lam, config)
    return np.asarray(design_score(metric, config).score)


@pytest.mark.parametrize("config", CONVENTIONS)
@pytest.mark.parametrize("shape", [(3, 5, 10, 40), (2, 2, 3, 1), (2, 7, 6, 130)])
@pytest.mark.parametrize(("dtype", "error"), [(np.float64, 1e-10), (np.float32, 2e-3)])
def test_it_equals_the_metric_under_every_convention(
    config: MetricConfig, shape: tuple[int, int, int, int], dtype: type, error: float
) -> None:
    bends, sites, facets, lanes = shape
    rng = np.random.default_rng(sum(shape))
    cells = (bends * sites, facets, 3)
    base: np.ndarray = np.asarray(rng.uniform(-20.0, 120.0, cells), dtype)
    block: np.ndarray = np.asarray(rng.uniform(-20.0, 150.0, (*cells, lanes)), dtype)
    block[0, 1] = -500.0  # a black facet in every lane
    args = (base, block, bends, 60.0, config)
    np.testing.assert_allclose(vectorized_score(*args), plain_score(*args), rtol=0, atol=error)


def direct_score(counts: np.ndarray, lam: float) -> float:
    """Eqs. (4.6) and (4.7) of ``(bend, site, facet, channel)``, written out in plain Python."""
    by_cell = []
    for row in counts:
        for facets in row:
            seen = [[min(max(float(v), 0.0), 255.0) for v in facet] for facet in facets]
            length = [math.sqrt(sum(v * v for v in facet)) for facet in seen]
            hue = [[v / n for v in facet] for facet, n in zip(seen, length, strict=True)]
            step = [math.dist(one, two) for one, two in zip(hue, hue[1:] + hue[:1], strict=True)]
            parts = [(sum(x) / len(x) - float(np.std(x))) for x in (length, step)]
            by_cell.append(parts[0] + lam * parts[1])
    metric = np.array(by_cell).reshape(counts.shape[:2])
    return float(metric.mean() - metric.mean(axis=0).std() - metric.mean(axis=1).std())


@pytest.mark.slow
@pytest.mark.parametrize("channels", [1, 6])
def test_any_number_of_channels_is_the_formula(channels: int) -> None:
    rng = np.random.default_rng(channels)
    block = rng.uniform(-5.0, 280.0, (2 * 3, 5, channels, 4))
    block[..., 0, :] = np.abs(block[..., 0, :]) + 1.0  # no facet is black
    args = (np.zeros(block.shape[:-1]), block, 2, 30.0, MetricConfig())
    for lane, score in enumerate(vectorized_score(*args)):
        counts = block[..., lane].reshape(2, 3, 5, channels)
        assert score == pytest.approx(direct_score(counts, 30.0), rel=1e-12)
        clipped = clip_counts(counts)
        plain = design_score(site_metric(clipped, 30.0)).score
        assert float(plain) == pytest.approx(direct_score(counts, 30.0), rel=1e-12)


def test_one_bend_one_site_has_no_spread() -> None:
    block = np.random.default_rng(0).uniform(0.0, 255.0, (1, 5, 3, 2))
    args = (np.zeros((1, 5, 3)), block, 1, 10.0, MetricConfig())
    np.testing.assert_allclose(vectorized_score(*args), plain_score(*args), atol=1e-10)


def test_nan_spoils_its_own_lane_only() -> None:
    block = np.full((2, 4, 3, 20), 50.0)
    block[1, 2, 0, 7] = np.nan
    scores = vectorized_score(np.zeros((2, 4, 3)), block, 1, 10.0, MetricConfig())
    assert np.flatnonzero(np.isnan(scores)).tolist() == [7]


def total(values: np.ndarray) -> float:
    result = 0.0
    for value in values:
        result += value
    return result


def test_nan_stays_nan() -> None:
    assert math.isnan(vectorized(total)(np.array([1.0, np.nan])))
