"""Designs that are rendered together."""

from __future__ import annotations

import numpy as np

from optimize.design import Design
from optimize.verification.design_renders import distinct_directions


def test_designs_of_equal_directions_share_a_node() -> None:
    phi = np.full(4, 1.0)
    designs = [
        Design.of_colors(phi, [0, 1, 2, 0]),
        Design.of_colors(phi + 0.1, [0, 1, 2, 0]),
        Design.of_colors(phi, [2, 1, 0, 0]),
    ]
    nodes, which = distinct_directions(designs)
    assert nodes.shape == (4, 2)
    assert which.tolist() == [0, 1, 0]
