"""Renaming colors."""

from __future__ import annotations

import numpy as np

from optimize.search.colors import canonical, renamed_like


def test_canonical_names_follow_the_first_appearance() -> None:
    colors = np.array([[2, 2, 0, 1], [1, 1, 1, 1], [0, 2, 0, 2]])
    assert canonical(colors).tolist() == [[0, 0, 1, 2], [0, 0, 0, 0], [0, 1, 0, 1]]
    assert canonical(colors[0]).tolist() == [0, 0, 1, 2]


def test_renaming_keeps_as_many_colors_as_it_can() -> None:
    reference = np.array([0, 0, 2, 2, 1])
    assert renamed_like(np.array([0, 0, 1, 1, 2]), reference).tolist() == [0, 0, 2, 2, 1]
