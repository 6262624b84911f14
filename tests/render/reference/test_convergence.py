"""Cells that have not converged are counted, and told how many samples more they need."""

from __future__ import annotations

import re

import numpy as np

from render.reference import converged, doubt, more_samples


def test_a_cell_has_converged_below_half_its_light_and_never_where_it_is_dark_or_unseen() -> None:
    mean = np.array([1.0, 1.0, 0.0, np.nan, 2.0])
    error = np.array([0.49, 0.5, 0.1, np.nan, np.inf])
    assert converged(mean, error).tolist() == [True, False, False, False, False]


def test_nothing_is_said_where_all_cells_that_are_seen_have_converged() -> None:
    assert doubt(np.array([1.0, np.nan]), np.array([0.1, np.nan]), 600) == ""


def test_the_samples_that_are_asked_for_bring_nine_cells_in_ten_there() -> None:
    rng = np.random.default_rng(1)
    mean, each = rng.uniform(1.0, 5.0, 1000), rng.uniform(0.2, 2.0, 1000)
    said = doubt(mean, each * mean, 600)
    more = float(re.search(r"about ([\d,]+) samples more", said)[1].replace(",", ""))  # type: ignore[index]
    later = each * np.sqrt(600 / (600 + more))
    before = ~converged(mean, each * mean)
    assert f"carry {before.sum()} of 1,000 cells" in said
    after = converged(mean, later * mean)[before].mean()
    assert 0.88 < after < 0.92


def test_of_cells_without_any_light_it_is_said_that_much_is_missing() -> None:
    said = doubt(np.zeros(4), np.ones(4), 10)
    assert said.startswith("Not converged: few light paths carry 4 of 4 cells")
    assert "more than 990 samples more per cell" in said
    assert more_samples(np.zeros(4), np.ones(4)) == "more than 100 times the samples are needed"
