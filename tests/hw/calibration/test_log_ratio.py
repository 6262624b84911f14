"""Log ratios of rendered to modeled light: one per part, and not darker than the light is."""

from __future__ import annotations

import numpy as np

from hw.calibration.log_ratio import log_ratios


def test_blocks_of_a_cell_count_once() -> None:
    place = np.array([[0.0, 2.0], [0.5, 2.0], [4.0, 2.0], [6.0, 2.0]])
    found = log_ratios(
        place, np.array([7, 7, 8, 9]), np.array([2.0, 2.0, 4.0, 1.0]),
        np.array([0.2, 0.2, 0.4, 0.1]), np.zeros(4),
    )  # fmt: skip
    np.testing.assert_allclose(found.place, [[0.25, 2.0], [4.0, 2.0], [6.0, 2.0]])
    np.testing.assert_allclose(found.log_ratio, np.log([2.0, 4.0, 1.0]) + 0.005)
    np.testing.assert_allclose(found.variance, 0.01)


def test_light_with_heavy_tails_is_not_made_darker() -> None:
    rng = np.random.default_rng(4)
    place = np.stack(np.meshgrid(np.arange(-6.0, 7.0, 2.0), np.arange(1.0, 14.0, 2.0)), -1)
    place = place.reshape(-1, 2)
    data, weighted = [], []
    for _ in range(40):
        paths = np.exp(1.5 * rng.standard_normal((len(place), 8, 40)) - 0.5 * 1.5**2).mean(axis=2)
        radiance, error = paths.mean(axis=1), paths.std(axis=1, ddof=1) / np.sqrt(8)
        data.append(log_ratios(place, np.arange(len(place)), radiance, error, np.zeros(len(place))))
        weighted.append(np.average(np.log(radiance), weights=(radiance / error) ** 2))
    assert np.mean(weighted) < -0.03
    found = [np.average(one.log_ratio, weights=1 / one.variance) for one in data]
    assert abs(np.mean(found)) < 0.012
