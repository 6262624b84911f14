"""CMA-ES over directions: known optima, ties between fibers, limits, failures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from optimize.search import optimize_directions, tied_groups
from render.errors import TactiluxError

Array = NDArray[np.float64]
PEAK = np.array([0.4, 1.0, 1.6, 2.2, 2.8])


def peaked(phi: Array) -> Array:
    return np.asarray(np.cos(phi - PEAK).sum(axis=-1))


def test_free_directions_find_the_known_peak() -> None:
    result = optimize_directions(peaked, np.full(5, np.pi / 2))
    np.testing.assert_allclose(result.phi, PEAK, atol=0.01)
    assert result.converged
    assert result.score == pytest.approx(5.0, abs=1e-3)
    assert result.score == peaked(result.phi)


def test_tied_directions_find_the_best_common_one() -> None:
    groups = np.array([0, 0, 0, 1, 1])
    result = optimize_directions(peaked, np.full(5, np.pi / 2), groups=groups)
    np.testing.assert_allclose(result.phi, [1.0, 1.0, 1.0, 2.5, 2.5], atol=0.01)


def test_a_single_direction_can_be_searched() -> None:
    result = optimize_directions(lambda phi: -((phi[:, 0] - 0.7) ** 2), np.array([2.0]))
    assert result.phi[0] == pytest.approx(0.7, abs=0.01)


def test_a_peak_beyond_the_limit_ends_at_the_limit() -> None:
    result = optimize_directions(lambda phi: phi.sum(axis=-1), np.full(3, 1.0))
    assert (result.phi <= np.pi).all()
    np.testing.assert_allclose(result.phi, np.pi, atol=0.01)


def test_the_same_seed_repeats_and_leaves_the_global_generator_alone() -> None:
    start = np.full(5, 1.0)
    np.random.seed(1)  # noqa: NPY002
    first = optimize_directions(peaked, start, seed=7)
    untouched = np.random.random()  # noqa: NPY002
    np.random.seed(1)  # noqa: NPY002
    assert np.random.random() == untouched  # noqa: NPY002
    second = optimize_directions(peaked, start, seed=7)
    np.testing.assert_array_equal(first.phi, second.phi)
    assert (first.score, first.evaluated) == (second.score, second.evaluated)


def test_the_best_score_only_rises_and_evaluations_are_limited() -> None:
    seen: list[tuple[int, float]] = []
    result = optimize_directions(
        peaked,
        np.full(5, 0.1),
        max_evaluations=50,
        progress=lambda *at: seen.append(at),
    )
    assert not result.converged
    assert 50 <= result.evaluated < 70
    assert seen == sorted(seen)
    assert seen[-1] == (result.evaluated, result.score)


def test_nan_from_a_model_is_an_error_not_a_penalty() -> None:
    def broken(phi: Array) -> Array:
        return np.where(phi[:, 0] > 1.2, np.nan, peaked(phi))

    with pytest.raises(TactiluxError, match="not finite, the first at angles_deg"):
        optimize_directions(broken, np.full(5, 1.1))


def test_groups_follow_side_and_color() -> None:
    groups = tied_groups(["left", "left", "right", "left"], np.array([1, 2, 1, 1]))
    assert groups.tolist() == [0, 1, 2, 0]


def test_nothing_is_written_to_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    optimize_directions(peaked, np.full(5, 1.0), max_evaluations=30)
    assert not list(tmp_path.iterdir())
