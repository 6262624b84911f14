"""A model says whether it can rank designs, and what more samples would bring."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from surrogate.runtime import ModelMetadata, RankingTest
from surrogate.runtime.metadata import NOISE, held_out_row
from surrogate.train import Trained
from surrogate.training.evaluation import kendall_tau


def described(about: ModelMetadata, tau: float, noise_tau: float) -> ModelMetadata:
    """Return ``about`` with other rankings of held-out designs, and a render of 6 minutes."""
    kind = str(about.residual["kind"])
    rows = [
        held_out_row({"name": NOISE, "kendall_tau": noise_tau}, None, kind),
        held_out_row({"name": kind, "kendall_tau": tau}, None, kind),
    ]
    return replace(about, held_out=rows, renderer={"samples_per_cell": 200})


def test_a_good_model_gives_no_advice(trained: Trained) -> None:
    found = RankingTest.of(trained.metadata)
    assert found.reliable
    assert found.advice() == ""


def test_a_model_without_a_residual_ranks_as_its_preview(trained: Trained) -> None:
    about = described(trained.metadata, 0.4, 0.6)
    rows = [*about.held_out, held_out_row({"name": "preview", "kendall_tau": 0.7}, None, "none")]
    bare = replace(about, held_out=rows, residual=about.residual | {"kind": "none"})
    assert RankingTest.of(bare).tau == 0.7


def test_a_converged_preview_vouches_for_a_model_whose_renders_are_noisy(trained: Trained) -> None:
    about = described(trained.metadata, 0.4, 0.6)
    vouched = replace(about, preview=about.preview | {"ranks": 0.9})
    assert RankingTest.of(vouched).tau == 0.9
    assert RankingTest.of(vouched).advice() == ""


def test_a_noisy_reference_asks_for_more_samples_and_says_how_many(
    trained: Trained,
) -> None:
    found = RankingTest.of(described(trained.metadata, 0.4, 0.6))
    assert not found.reliable
    advice = found.advice()
    assert "Kendall's tau is 0.40, needed: 0.85" in advice
    words = r"at least (\S+) times the samples \(--samples (\d+)\)"
    told = [float(number) for number in re.search(words, advice).groups()]
    assert told == pytest.approx([found.factor, 200 * found.factor], rel=0.05)


def test_a_hopeless_reference_asks_for_at_least_a_hundred_times(trained: Trained) -> None:
    advice = RankingTest.of(described(trained.metadata, 0.05, 0.2)).advice()
    assert "at least 100 times" in advice


def test_where_the_renders_are_good_more_of_them_are_not_advised(trained: Trained) -> None:
    advice = RankingTest.of(described(trained.metadata, 0.5, 0.97)).advice()
    assert "more samples will not help" in advice


def test_cells_that_few_light_paths_carry_are_named_as_a_reason(trained: Trained) -> None:
    about = described(trained.metadata, 0.4, 0.6)
    words = "Few light paths carry"
    for share in (0.05, 0.34):
        residual = about.residual | {"unreliable_cells": int(1000 * share), "cells": 1000}
        advice = RankingTest.of(replace(about, residual=residual)).advice()
        assert (f"{words} 34% of the cells" in advice) == (share == 0.34)
        assert (words in advice) == (share == 0.34)


@pytest.mark.parametrize("noise", [0.3, 0.6])
def test_as_many_times_the_samples_let_a_perfect_model_reach_the_aim(
    trained: Trained, noise: float
) -> None:
    rng = np.random.default_rng(4)
    truth, first, again, longer = rng.standard_normal((4, 3000))
    noise_tau = kendall_tau(truth + noise * first, truth + noise * (first + again))
    factor = RankingTest.of(described(trained.metadata, 0.0, noise_tau)).factor
    reached = kendall_tau(truth, truth + noise / math.sqrt(factor) * longer)
    assert reached == pytest.approx(0.9, abs=0.02)
