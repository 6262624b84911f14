"""What a budget of minutes buys."""

from __future__ import annotations

import numpy as np
import pytest

from render.progress import Progress
from render.reference import cost as pace
from render.scene.schema import load_scene


def test_the_pace_is_the_slope_between_two_renders_and_the_rest(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock, rendered = [0.0], []
    real = pace.render_transport

    def counted(*args: object, samples: int, **rest: object) -> object:
        # Real renders of a known duration: 3 s and 0.5 s per mutation of every cell.
        steps: list[Progress] = []
        found = real(*args, samples=samples, progress=steps.append, **rest)  # type: ignore[arg-type]
        rendered.append(steps[-1].total)
        clock[0] += 3.0 + 0.5 * samples
        return found

    monkeypatch.setattr(pace, "TRIALS", (2, 6))
    monkeypatch.setattr(pace, "render_transport", counted)
    monkeypatch.setattr("render.reference.cost.time.monotonic", lambda: clock[0])
    found = pace.render_pace(load_scene("finger20"), np.array([1.0]))
    assert (found.fixed, found.each, found.spent) == pytest.approx((3.0, 0.5, 10.0))
    assert rendered[1] == pytest.approx(3 * rendered[0], rel=0.1)
