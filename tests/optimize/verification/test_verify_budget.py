"""How many samples a verification takes is kept, so that it goes on with the same number."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from optimize.verification import verify_budget
from render.reference.cost import RenderCost
from render.scene.schema import Scene
from tests.disk import DURABLE, logged_disk


def test_the_plan_is_synced_and_asked_instead_of_measuring_again(
    finger20: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def samples() -> int:
        return verify_budget.affordable_samples(
            finger20, np.zeros(20), minutes=1.0, seeds=2, designs=1, folder=tmp_path
        )

    measured = RenderCost(1.0, 0.5, trials=6.0)
    monkeypatch.setattr(verify_budget, "measure_render_cost", lambda *_: measured)
    calls = logged_disk(monkeypatch)
    # 54 s for three bends and two seeds, of which each render spends one at its start.
    assert samples() == 16
    assert calls == DURABLE
    monkeypatch.setattr(
        verify_budget, "measure_render_cost", lambda *_: pytest.fail("measured again")
    )
    assert samples() == 16
