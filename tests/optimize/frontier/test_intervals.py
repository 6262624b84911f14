"""Coverage of a model's intervals by an independent reference with noise of its own."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from optimize.frontier.designs import held_out_designs
from optimize.frontier.intervals import held_by_intervals
from optimize.frontier.reference import Reference
from render.scene.schema import Scene
from surrogate.runtime.checker import Checker

MODEL = Path(__file__).resolve().parents[3] / "models" / "finger20"


@pytest.mark.parametrize("noise", [0.0, 1.0, 10.0])
def test_intervals_hold_what_they_promise_whatever_the_noise_of_the_reference(
    finger20: Scene, noise: float
) -> None:
    # A world in which the model's errors are normal and its factors are right.
    checker = Checker.load(MODEL, finger20.hash)
    designs = held_out_designs(finger20, 60, 0)
    found = checker.run(designs.phi, designs.power, np.array(finger20.bending.angles))
    rng = np.random.default_rng(0)
    truth = found["counts"] + checker.counts_reach / 1.645 * found[
        "counts_spread"
    ] * rng.standard_normal(found["counts"].shape)
    scores = found["score"] + checker.score_reach / 1.645 * rng.standard_normal(60)
    reference = Reference(
        counts=truth + noise * rng.standard_normal(truth.shape),
        counts_se=np.full(truth.shape, noise),
        scores=scores + noise * rng.standard_normal(60),
        scores_se=np.full(60, noise),
        exposure=checker.exposure,
        lam=checker.lam,
        samples=1,
        replicates=10_000,
        seconds=1.0,
    )
    held = held_by_intervals(finger20, checker, designs, reference)
    assert held.nominal == 0.9
    assert held.counts == pytest.approx(0.9, abs=0.02)
    assert held.score == pytest.approx(0.9, abs=0.1)
    far = replace(reference, counts=reference.counts + 100.0 + 10 * noise)
    assert held_by_intervals(finger20, checker, designs, far).counts < 0.1
