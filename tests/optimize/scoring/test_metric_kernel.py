"""The compiled metric is the metric; compiled functions keep NaN, and need no cache."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numba.core.caching import CacheImpl

from optimize.scoring.metric_kernel import compiled, kernel_constants, score_lanes
from render.metric import MetricConfig, clip_counts, design_score, site_metric

CONVENTIONS = [
    MetricConfig(),
    MetricConfig(ddof=1),
    MetricConfig(cyclic=False),
    MetricConfig(count_max=90.0),
]


def compiled_score(
    base: np.ndarray, block: np.ndarray, bends: int, lam: float, config: MetricConfig
) -> np.ndarray:
    out = np.empty(block.shape[-1], block.dtype)
    score_lanes(base, block, bends, kernel_constants(config, lam, block.dtype), out)
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
    np.testing.assert_allclose(compiled_score(*args), plain_score(*args), rtol=0, atol=error)


def test_one_bend_one_site_has_no_spread() -> None:
    block = np.random.default_rng(0).uniform(0.0, 255.0, (1, 5, 3, 2))
    args = (np.zeros((1, 5, 3)), block, 1, 10.0, MetricConfig())
    np.testing.assert_allclose(compiled_score(*args), plain_score(*args), atol=1e-10)


def test_nan_spoils_its_own_lane_only() -> None:
    block = np.full((2, 4, 3, 20), 50.0)
    block[1, 2, 0, 7] = np.nan
    scores = compiled_score(np.zeros((2, 4, 3)), block, 1, 10.0, MetricConfig())
    assert np.flatnonzero(np.isnan(scores)).tolist() == [7]


def total(values: np.ndarray) -> float:
    result = 0.0
    for value in values:
        result += value
    return result


def test_an_install_without_a_writable_cache_still_computes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(CacheImpl, "_locator_classes", [])  # as numba finds no writable folder
    assert compiled(total)(np.array([1.0, 2.0])) == 3.0


def test_nan_stays_nan() -> None:
    assert math.isnan(compiled(total)(np.array([1.0, np.nan])))
