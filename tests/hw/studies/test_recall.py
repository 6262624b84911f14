"""The study of random rigs is repeatable and finds what it should."""

from __future__ import annotations

import numpy as np

from hw.check.prediction import PadPrediction
from hw.studies.recall import RigSpread, measure_recall
from render.geometry import flat_sites
from render.scene import load_scene

SITES = flat_sites(load_scene("finger20"))[:, :2]


def test_ideal_rigs_have_no_missed_faults(prediction: PadPrediction) -> None:
    ideal = RigSpread(
        power=0.0, turn=0.0, power_drift=0.0, turn_drift=0.0, gain=0.0, gain_drift=0.0,
        model=1e-6, shift=0.0, pixel_noise=0.05,
    )  # fmt: skip
    sweep = measure_recall(prediction, SITES, rigs=6, seed=3, spread=ideal)[0]
    assert sweep.way == "sweep, commissioned"
    assert set(sweep.found.values()) == {1.0}
    assert sweep.false_alarms == 0.0


def test_a_seed_repeats_the_study(prediction: PadPrediction) -> None:
    first, second = (measure_recall(prediction, SITES, rigs=2, seed=5) for _ in range(2))
    assert first == second


def test_noise_that_hides_everything_hides_faults(prediction: PadPrediction) -> None:
    noisy = RigSpread(pixel_noise=2000.0)
    sweep = measure_recall(prediction, SITES, rigs=3, seed=1, spread=noisy)[0]
    assert np.mean(list(sweep.found.values())) < 0.6
