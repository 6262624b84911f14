"""Designs that are rendered together, and what renders say of finalists."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from optimize.design import Design, ScoreSettings, baseline_design
from optimize.verification.design_renders import (
    distinct_directions,
    evaluate_finalists,
)
from render.scene import Scene
from render.transport import TransportTable
from tests.optimize.verification.pretended_renders import BASE, biased, pretended


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


def test_the_evaluation_of_finalists_tells_a_gain_from_a_tie(
    small: Scene, table: TransportTable
) -> None:
    base, settings = baseline_design(small), ScoreSettings(table.exposure, table.lam)
    dim = Design(base.phi, 0.5 * base.power)
    same = Design(base.phi + 1e-4, base.power)
    found = evaluate_finalists(
        pretended(table, 0.02), settings, [("baseline", base), ("dim", dim), ("same", same)],
        samples=3, seeds=[1, 2],
    )  # fmt: skip
    assert found.comparison("dim", "baseline").startswith("The baseline is better than the dim")
    assert "tie" in found.comparison("baseline", "same")
    plural = replace(found, names=("baseline", "colors", *found.names[2:]))
    said = {plural.comparison("baseline", "colors"), plural.comparison("colors", "baseline")}
    assert all(text.startswith("The baseline is better than the colors") for text in said)
    worse = replace(plural, names=("colors", "baseline", *found.names[2:]))
    assert worse.comparison("colors", "baseline").startswith(
        "The colors are better than the baseline"
    )
    exact = settings.parts(table.at(base.phi) * biased(base.phi, BASE)[:, None, None, None],
                        base.power)[0]  # fmt: skip
    score = found.score("baseline").score
    assert score.value == pytest.approx(exact, abs=4 * score.se)
