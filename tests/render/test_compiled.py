"""Compiled functions where numba finds no folder to keep machine code in."""

import numpy as np
import pytest
from numba.core.caching import CacheImpl

from render.compiled import compiled


def total(values: np.ndarray) -> float:
    result = 0.0
    for value in values:
        result += value
    return result


def test_an_install_without_a_writable_cache_still_computes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(CacheImpl, "_locator_classes", [])
    assert compiled(total)(np.array([1.0, 2.0])) == 3.0
