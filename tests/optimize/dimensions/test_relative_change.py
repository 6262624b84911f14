"""Changes of errors: their intervals hold noise of draws, of photons and of models."""

from __future__ import annotations

import numpy as np
import pytest

from optimize.dimensions import RelativeChange, relative_change
from optimize.dimensions.answer import LightErrors, StudyEffort
from optimize.dimensions.relative_change import MODEL_SPREAD

EFFORT_NAMES: tuple[StudyEffort, ...] = ("drawn", "few", "converged")


def errors(draws: np.ndarray, noisier: np.ndarray | None = None) -> LightErrors:
    more = {} if noisier is None else {"sensor": noisier, "place": noisier}
    return LightErrors(draws, draws, more, exposure=1.0, score=0.0)


@pytest.fixture
def draws() -> np.ndarray:
    return 2.0 * np.exp(0.02 * np.random.default_rng(3).standard_normal(8))


@pytest.mark.parametrize("effort", EFFORT_NAMES)
def test_a_sensor_does_not_differ_from_itself_but_for_the_model(
    draws: np.ndarray, effort: StudyEffort
) -> None:
    change = relative_change(errors(draws), errors(draws), "sensor", effort)
    low, high = change.interval
    assert change.value == 0.0
    assert np.log1p([low, high]) == pytest.approx(
        [-1.96 * MODEL_SPREAD[effort], 1.96 * MODEL_SPREAD[effort]], rel=1e-3
    )


def test_a_known_factor_is_found_whatever_the_draws(draws: np.ndarray) -> None:
    change = relative_change(errors(draws), errors(0.8 * draws), "place", "converged")
    assert change.value == pytest.approx(-0.2)
    assert change.lower
    back = relative_change(errors(0.8 * draws), errors(draws), "place", "converged")
    assert 1.0 + back.interval[1] == pytest.approx(1.0 / (1.0 + change.interval[0]))


def test_intervals_of_many_comparisons_are_wider(draws: np.ndarray) -> None:
    widths = [
        np.ptp(relative_change(errors(draws), errors(draws), "sensor", "few", count).interval)
        for count in (1, 2, 9)
    ]
    assert widths[0] < widths[1] < widths[2]


def test_intervals_hold_the_truth_as_often_as_they_say() -> None:
    rng, held, effort = np.random.default_rng(11), 0, EFFORT_NAMES[1]
    for _ in range(400):
        common = 0.1 * rng.standard_normal(8)
        model = np.exp(MODEL_SPREAD[effort] * rng.standard_normal())
        first = np.exp(common)
        other = 0.9 * model * np.exp(common + 0.02 * rng.standard_normal(8))
        low, high = relative_change(errors(first), errors(other), "sensor", effort).interval
        held += low <= -0.1 <= high
    assert 0.93 <= held / 400 <= 0.985


def test_photon_noise_is_taken_out_where_squares_grow_with_its_variance() -> None:
    light, noise = 1.5, 0.9
    once, twice = (np.full(4, np.sqrt(light**2 + part * noise**2)) for part in (1.0, 2.0))
    found = errors(once, twice)
    assert found.mean("sensor") == pytest.approx(light)
    assert found.measured("sensor") == pytest.approx(once[0])
    # The interval reaches back to what was measured.
    change = relative_change(errors(np.full(4, light)), found, "sensor", "converged")
    assert change.value == pytest.approx(0.0, abs=1e-12)
    assert 1.0 + change.interval[1] > once[0] / light


def test_an_error_that_is_all_noise_is_halved_at_most() -> None:
    assert errors(np.full(4, 2.0), np.full(4, 4.0)).mean("place") == 1.0


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ((-0.124, (-0.151, -0.09)), "12 % [9, 15] lower"),
        ((0.03, (-0.06, 0.13)), "3 % [-6, 13] higher"),
        ((0.0, (-0.001, 0.001)), "0 % [0, 0] higher"),
    ],
)
def test_changes_are_said_as_people_say_them(
    change: tuple[float, tuple[float, float]], words: str
) -> None:
    assert RelativeChange(*change).words == words
