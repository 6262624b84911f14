"""The loop's seconds of rendering beside the thesis procedure's."""

from __future__ import annotations

import pytest

from optimize.verification.optimization import BUDGET, OptimizeConfig, rounds_seconds


def test_rounds_take_half_of_the_loops_seconds() -> None:
    assert rounds_seconds(1200.0, 1000, OptimizeConfig()) == pytest.approx(30.0)


def test_rounds_leave_the_finalists_their_first_batch() -> None:
    """As measured on random-4: 182 renders in 240 s, a batch of four times the samples in 6.8 s."""
    rounds = rounds_seconds(240.0, 182, OptimizeConfig())
    assert 2.7 < rounds < BUDGET * 240.0 - 6.8
    more = rounds_seconds(240.0, 182, OptimizeConfig(final_seeds=3))
    assert more < rounds
