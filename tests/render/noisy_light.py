"""Transport of facets that differ by a known spread, in replicates of known noise."""

from __future__ import annotations

import numpy as np

EXPOSURE = 50.0
THREE = np.eye(3)
SHAPE = (3, 1, 40, 10)
"""Lamps, bends, sites, facets."""
REPLICATES = 8


def noisy_light(spread: float, noise: float, seed: int = 0) -> np.ndarray:
    """Return light around 1: facets differ by ``spread``, the mean of replicates by ``noise``."""
    rng = np.random.default_rng(seed)
    truth = 1.0 + spread * rng.standard_normal(SHAPE)
    each = noise * np.sqrt(REPLICATES) * rng.standard_normal((REPLICATES, *SHAPE))
    return np.asarray(truth + each)
