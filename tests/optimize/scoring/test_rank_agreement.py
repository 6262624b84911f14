"""Kendall's tau over the pairs that renders decide."""

from __future__ import annotations

import numpy as np

from optimize.scoring import rank_agreement


def test_undecided_pairs_do_not_count_in_the_ranking() -> None:
    interval = {(0, 1): (1.0, 2.0), (0, 2): (-1.0, 2.0), (1, 2): (-3.0, -1.0)}
    right = rank_agreement(np.array([1.0, 3.0, 2.0]), lambda i, j: interval[i, j])
    assert (right.tau, right.decided, right.pairs) == (1.0, 2, 3)
    wrong = rank_agreement(np.array([3.0, 2.0, 2.5]), lambda i, j: interval[i, j])
    assert wrong.tau == -1.0
    nothing = rank_agreement(np.array([1.0, 2.0]), lambda i, j: (-1.0, 1.0))
    assert nothing.tau is None
    assert "none of 1 pairs" in nothing.shown
