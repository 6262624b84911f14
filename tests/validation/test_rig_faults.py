"""How many single-fiber faults the start-up check finds on random rigs, and how often it errs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binomtest

from hw.check.prediction import PadPrediction, predict
from render.geometry import flat_sites
from render.scene import load_scene
from surrogate.runtime import Checker
from tests.hw.palettes import RESPONSES, matrix
from tests.hw.random_rigs import MAX_FALSE_ALARMS, MIN_RECALL, Recall, RigSpread, measure_recall
from tests.long import LONG

MODEL = Path(__file__).parents[2] / "models" / "finger20"
SITES = flat_sites(load_scene("finger20"))[:, :2]
RIGS = 500 if LONG else 60
TINTS = np.array([1.0, 0.4, 0.7])
"""Light of the channels on a skin with an albedo for each."""


@pytest.fixture(scope="module")
def prediction() -> PadPrediction:
    """Ask the shipped model; random rigs have directions and powers of their own."""
    return predict(Checker.load(MODEL, threads=2), np.full(20, np.pi / 2), np.ones((20, 3)), 0.0)


def percent(part: float, count: int) -> str:
    """Return a percentage with its 95 % interval (Wilson 1927)."""
    low, high = binomtest(round(part * count), count).proportion_ci(method="wilson")
    return f"{100 * part:5.1f} % ({100 * low:.1f} to {100 * high:.1f})"


def told(one: Recall) -> str:
    """Return the table of one way of checking."""
    faults = "".join(
        f"  {fault:<12} found {percent(part, one.rigs)}, named rightly "
        f"{percent(one.named[fault], one.rigs)}\n"
        for fault, part in one.found.items()
    )
    return (
        f"{one.way}\n{faults}  false alarms {percent(one.false_alarms, one.rigs)} of healthy rigs; "
        f"a healthy fiber blamed in {percent(one.blamed, 4 * one.rigs)} of faulty ones"
    )


@pytest.mark.parametrize("seed", [0, 5000] if LONG else [0])
def test_a_sweep_against_the_rigs_record_keeps_its_bound(
    prediction: PadPrediction, seed: int
) -> None:
    found = measure_recall(prediction, SITES, rigs=RIGS, seed=seed)
    print(f"\n{RIGS} random rigs, seed {seed}", *map(told, found), sep="\n")
    best = found[0]
    assert best.way == "sweep, commissioned"
    assert min(best.found.values()) >= MIN_RECALL
    alarms = round(best.false_alarms * RIGS)
    # One alarm of a few rigs is more than the bound's rate, and yet no evidence against it.
    assert binomtest(alarms, RIGS, MAX_FALSE_ALARMS, "greater").pvalue > 0.05
    assert not LONG or best.false_alarms <= MAX_FALSE_ALARMS


def test_skins_with_an_albedo_per_channel_keep_the_bound_but_for_turned_fibers_of_two_colors(
    prediction: PadPrediction,
) -> None:
    tinted = replace(prediction, table=prediction.table[..., None] * TINTS)
    found = measure_recall(tinted, SITES, rigs=RIGS, seed=0)
    print(f"\n{RIGS} random rigs, light by channel, seed 0", *map(told, found), sep="\n")
    best = found[0]
    alarms = round(best.false_alarms * RIGS)
    assert binomtest(alarms, RIGS, MAX_FALSE_ALARMS, "greater").pvalue > 0.05
    turned = best.found.pop("10 deg off")
    assert min(best.found.values()) >= MIN_RECALL
    # What LEDs of one fiber drift apart hides a part of what two of them say of a turn.
    assert turned >= 0.85


@pytest.mark.parametrize("name", RESPONSES if LONG else [*RESPONSES][:4:3])
def test_rigs_of_any_leds_keep_the_bound_before_any_camera(
    prediction: PadPrediction, name: str
) -> None:
    response = matrix(name)
    rig = replace(prediction, response=response, power=np.ones((20, len(response))))
    found = measure_recall(rig, SITES, rigs=RIGS, seed=0)
    print(f"\n{RIGS} random rigs, {name}, seed 0", *map(told, found), sep="\n")
    best = found[0]
    if len(response) == 1:
        # There is no other color.
        del best.found["swapped"]
    # Turned fibers change the light of a camera of several channels no more than that of one.
    assert best.found.pop("10 deg off") >= 0.8
    assert min(best.found.values()) >= MIN_RECALL
    alarms = round(best.false_alarms * RIGS)
    assert binomtest(alarms, RIGS, MAX_FALSE_ALARMS, "greater").pvalue > 0.05


def test_ideal_rigs_have_no_missed_faults(prediction: PadPrediction) -> None:
    ideal = RigSpread(
        power=0.0, turn=0.0, power_drift=0.0, turn_drift=0.0, gain=0.0, gain_drift=0.0,
        model=1e-6, shift=0.0, pixel_noise=0.05,
    )  # fmt: skip
    sweep = measure_recall(prediction, SITES, rigs=6, seed=3, spread=ideal)[0]
    assert set(sweep.found.values()) == {1.0}
    assert sweep.false_alarms == 0.0


def test_noise_that_hides_everything_hides_faults(prediction: PadPrediction) -> None:
    noisy = RigSpread(pixel_noise=2000.0)
    sweep = measure_recall(prediction, SITES, rigs=3, seed=1, spread=noisy)[0]
    assert np.mean(list(sweep.found.values())) < 0.6
