"""What a round renders: new designs that differ."""

from __future__ import annotations

import numpy as np
import pytest

from optimize.design import Design, ScoreSettings, baseline_design
from optimize.objectives import OBJECTIVES, ObjectiveName
from optimize.scoring import TableScorer
from optimize.search.colors import canonical
from optimize.verification.design_proposals import (
    expected_improvement,
    propose,
    random_design,
    same_design,
)
from optimize.verification.judges import judge_of
from render.scene import Scene
from render.transport import TransportTable


@pytest.mark.parametrize("objective", OBJECTIVES)
def test_proposals_are_new_and_differ(
    small: Scene, table: TransportTable, objective: ObjectiveName
) -> None:
    scorer, base = TableScorer(table), baseline_design(small)
    judge = judge_of(objective, small, ScoreSettings(table.exposure, table.lam))
    first = propose(scorer, base, judge, seed=4)
    assert [entry.role for entry in first] == ["best", "uncertain", "random"]
    # How far the surrogate may be off is known for S alone.
    assert all((entry.spread > 0) == (objective == "score") for entry in first)
    best, rival, other = (entry.score for entry in first)
    assert best >= rival
    assert best > other
    again = propose(scorer, base, judge, seed=4, known=[entry.design for entry in first])
    assert not again
    twin = first[0].design.colors[::-1]
    rival_colors = first[1].design.colors
    assert canonical(twin[None]).tolist() != canonical(rival_colors[None]).tolist()
    assert not same_design(random_design(scorer, 1), random_design(scorer, 2))


def test_the_rival_is_expected_to_gain_more_than_one_that_is_only_uncertain(
    small: Scene, table: TransportTable
) -> None:
    scorer, base = TableScorer(table), baseline_design(small)
    judge = judge_of("score", small, ScoreSettings(table.exposure, table.lam))
    best = propose(scorer, base, judge, seed=4)[0].design
    near = Design(best.phi + np.where(best.phi < 1.6, 0.05, -0.05), best.power)
    far = Design.of_colors(best.phi, np.zeros(small.lamp_count, dtype=np.int64))
    gains = [expected_improvement(scorer, design, best) for design in (near, far, best)]
    assert gains[0] > gains[1] >= 0.0
    assert gains[2] == 0.0


def test_a_gain_for_certain_is_expected_as_it_is_and_a_loss_for_certain_not_at_all(
    small: Scene, table: TransportTable
) -> None:
    # The same light a little brighter: whatever the table's errors, they share them.
    scorer, phi = TableScorer(table), baseline_design(small).phi
    power = np.eye(3)[np.arange(small.lamp_count) % 3]
    dim, bright = Design(phi, 0.40 * power), Design(phi, 0.41 * power)
    gain = scorer.score(phi, bright.power) - scorer.score(phi, dim.power)
    assert gain > 0.0
    assert expected_improvement(scorer, bright, dim) == pytest.approx(gain, rel=0.1)
    assert expected_improvement(scorer, dim, bright) < 0.01 * gain
