"""What a round renders: new designs that differ."""

from __future__ import annotations

from optimize.design import baseline_design
from optimize.scoring import TableScorer
from optimize.search.colors import canonical
from optimize.verification.design_proposals import propose, random_design, same_design
from render.geometry import fiber_edges
from render.scene import Scene
from render.transport import TransportTable


def test_proposals_are_new_and_differ(small: Scene, table: TransportTable) -> None:
    scorer, base = TableScorer(table), baseline_design(small)
    first = propose(scorer, base, edges=fiber_edges(small), seed=4)
    assert [entry.role for entry in first] == ["best", "uncertain", "random"]
    assert all(entry.spread > 0 for entry in first)
    again = propose(
        scorer, base, edges=fiber_edges(small), seed=4, known=[entry.design for entry in first]
    )
    assert not again
    twin = first[0].design.colors[::-1]
    other = first[1].design.colors
    assert canonical(twin[None]).tolist() != canonical(other[None]).tolist()
    assert not same_design(random_design(scorer, 1), random_design(scorer, 2))
