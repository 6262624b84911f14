"""Light that is followed stops when it is told to."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator

import numpy as np
import pytest

from render.preview.converged import Effort, transport_at
from render.progress import Clock, Progress
from tests.oracles.pads import scene_of_case


@pytest.fixture
def interruptible() -> Iterator[None]:
    """A shell may have begun the tests in the background, and told them to ignore SIGINT."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("interruptible")
def test_an_interrupt_is_heard_within_a_batch_of_each_thread() -> None:
    told: list[Progress] = []

    def interrupt(at: Progress) -> None:
        told.append(at)
        if len(told) == 1:
            os.kill(os.getpid(), signal.SIGINT)

    effort = Effort(paths=128, arrivals=40_000_000, rounds=1)
    scene = scene_of_case("smooth")
    with pytest.raises(KeyboardInterrupt):
        transport_at(scene, 0.0, np.array([1.2]), effort, Clock(1, interrupt))
    assert len(told) <= 2 * (os.cpu_count() or 1)
