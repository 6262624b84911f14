"""The smooth ratio finds a field through noise, also where it was not measured."""

from __future__ import annotations

import numpy as np
import pytest

from hw.calibration.log_ratio import LogRatios
from hw.emulator.rig import SmoothRatio
from render.arrays import Array


def field(place: Array) -> Array:
    return 0.08 * np.sin(place[:, 0] / 5.0) * np.cos(place[:, 1] / 6.0)


def measured(noise: float, fibers: int = 6, seed: int = 0) -> list[LogRatios]:
    """Return noisy samples of one field, with another constant for every fiber."""
    rng = np.random.default_rng(seed)
    found = []
    for fiber in range(fibers):
        place = rng.uniform([-6.0, 1.0], [6.0, 14.0], (40, 2))
        values = 0.3 * fiber + field(place) + noise * rng.standard_normal(len(place))
        found.append(LogRatios(place, values, np.full(len(place), noise**2)))
    return found


def test_the_field_is_found_between_the_samples() -> None:
    smooth = SmoothRatio(measured(0.03))
    wanted = np.stack(np.meshgrid(np.linspace(-4, 4, 5), np.linspace(3, 12, 5)), -1).reshape(-1, 2)
    found = smooth.mean([wanted] * 6).reshape(6, -1)
    for fiber, values in enumerate(found):
        error = values - field(wanted) - 0.3 * fiber
        assert np.abs(error).max() < 0.03


def test_nothing_measured_is_no_ratio() -> None:
    empty = LogRatios(np.zeros((0, 2)), np.zeros(0), np.zeros(0))
    with pytest.raises(ValueError, match="no render"):
        SmoothRatio([empty])
