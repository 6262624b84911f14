"""The smooth ratio finds a field through noise, also where it was not measured."""

from __future__ import annotations

import numpy as np
import pytest

from hw.calibration.reference_lines import frame_positions, reference_lines
from hw.calibration.smooth_ratio import LogRatios, SmoothRatio, in_frame, ratios
from render.arrays import Array
from render.scene.schema import load_scene


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


def test_blocks_of_a_cell_count_once() -> None:
    place = np.array([[0.0, 2.0], [0.5, 2.0], [4.0, 2.0], [6.0, 2.0]])
    found = ratios(
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
        data.append(ratios(place, np.arange(len(place)), radiance, error, np.zeros(len(place))))
        weighted.append(np.average(np.log(radiance), weights=(radiance / error) ** 2))
    assert np.mean(weighted) < -0.03
    found = [np.average(one.log_ratio, weights=1 / one.variance) for one in data]
    assert abs(np.mean(found)) < 0.012


def test_the_frame_is_that_of_the_reference_lines() -> None:
    scene = load_scene("finger20")
    lines = reference_lines(scene)
    for fiber in (0, 9, 15):
        np.testing.assert_allclose(
            in_frame(scene, fiber, lines.position[fiber]), frame_positions(), atol=1e-12
        )


def test_nothing_measured_is_no_ratio() -> None:
    empty = LogRatios(np.zeros((0, 2)), np.zeros(0), np.zeros(0))
    with pytest.raises(ValueError, match="no render"):
        SmoothRatio([empty])
