"""Renders confirm an interval, refute it, or are too noisy to say."""

from __future__ import annotations

import pytest

from optimize.scoring import check_interval, prediction_checked


def test_the_error_bar_of_the_renders_is_allowed_for_at_the_same_coverage() -> None:
    # 1.645 standard errors hold 90 % of a normal distribution.
    limit = (3.0**2 + (1.645 * 1.5) ** 2) ** 0.5
    assert check_interval(limit - 0.01, 3.0, 1.5) == "holds"
    assert check_interval(-limit - 0.01, 3.0, 1.5) == "does not hold"
    assert check_interval(limit + 0.01, 3.0, 1.5, coverage=0.95) == "holds"


@pytest.mark.parametrize("error", [0.0, 5.0, -40.0])
def test_renders_less_certain_than_the_interval_cannot_test_it(error: float) -> None:
    assert check_interval(error, 3.0, 30.0) == "cannot be tested"


def test_even_noisy_renders_refute_what_is_far_away() -> None:
    assert check_interval(100.0, 3.0, 30.0) == "does not hold"


def test_renders_that_have_not_converged_refute_nothing() -> None:
    assert check_interval(100.0, 3.0, 30.0, converged=False) == "cannot be tested"
    said = prediction_checked(91.03, 45.25, 15.66, converged=False)
    assert said.endswith("its 90% interval of ±45.25 cannot be tested")


def test_the_sentence_holds_the_error_bar_of_the_renders_that_decides() -> None:
    said = prediction_checked(10.29, 0.82, 9.5)
    assert said == "off by +10.29 (renders ±9.50): its 90% interval of ±0.82 cannot be tested"
    assert prediction_checked(-3.0, 0.82, 0.1).endswith("does not hold")
