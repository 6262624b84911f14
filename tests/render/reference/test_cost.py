"""What a budget of minutes buys."""

from __future__ import annotations

import numpy as np
import pytest

from render.progress import Progress
from render.reference import cost
from render.scene.schema import load_scene


def test_the_cost_of_a_sample_is_the_slope_between_two_renders_and_the_rest(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock, rendered = [0.0], []
    real = cost.render_transport

    def counted(*args: object, samples: int, **rest: object) -> object:
        # Real renders of a known duration: 3 s and 0.5 s per sample of every cell.
        steps: list[Progress] = []
        found = real(*args, samples=samples, progress=steps.append, **rest)  # type: ignore[arg-type]
        rendered.append(steps[-1].total)
        clock[0] += 3.0 + 0.5 * samples
        return found

    monkeypatch.setattr(cost, "TRIALS", (2, 6))
    monkeypatch.setattr(cost, "render_transport", counted)
    monkeypatch.setattr("render.reference.cost.time.monotonic", lambda: clock[0])
    found = cost.measure_render_cost(load_scene("finger20"), np.array([1.0]))
    assert (found.fixed, found.per_sample, found.trials) == pytest.approx((3.0, 0.5, 10.0))
    assert rendered[1] == pytest.approx(3 * rendered[0], rel=0.1)


def test_samples_fill_the_seconds_that_trials_and_beginnings_leave() -> None:
    known = cost.RenderCost(fixed=3.0, per_sample=0.5, trials=10.0)
    assert known.samples_within(10.0 + 2 * (3.0 + 0.5 * 8), [1.0, 1.0]) == 8
    assert known.samples_within(10.0 + 2 * 3.0 + 0.5 * (8 + 2), [1.0, 0.25]) == 8
    assert known.samples_within(1.0, [1.0]) < 1
