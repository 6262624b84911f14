"""Compiled functions keep NaN, and work where nothing can be stored."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numba.core.caching import CacheImpl

from optimize.scoring.compiled import compiled


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
