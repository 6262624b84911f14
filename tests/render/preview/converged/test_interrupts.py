"""Light that is followed stops when it is told to."""

from __future__ import annotations

import numpy as np
import pytest

from render.preview.converged import Effort, transport_at
from render.progress import Clock, Progress
from tests.oracles.pads import scene_of_case


def test_an_interrupt_is_heard_within_a_batch_of_each_thread() -> None:
    told: list[Progress] = []

    def interrupted(at: Progress) -> None:
        told.append(at)
        if len(told) == 1:
            raise KeyboardInterrupt

    effort = Effort(paths=128, arrivals=40_000_000, rounds=1)
    with pytest.raises(KeyboardInterrupt):
        transport_at(scene_of_case("smooth"), 0.0, np.array([1.2]), effort, Clock(1, interrupted))
    assert len(told) <= 8
