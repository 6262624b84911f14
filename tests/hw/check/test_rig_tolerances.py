"""What a check allows for is what random rigs do."""

from __future__ import annotations

import numpy as np
import pytest

from hw.check.prediction import PadPrediction
from hw.check.rig_tolerances import STARTS, RigTolerances, rig_tolerances
from render.geometry import flat_sites
from render.scene import load_scene
from tests.hw.random_rigs import RandomRig, RigSpread

SITES = flat_sites(load_scene("finger20"))[:, :2]


def test_a_turn_brings_back_as_much_of_the_models_error_as_rigs_have(
    prediction: PadPrediction,
) -> None:
    only_model = RigSpread(
        power=0.0, turn=0.0, power_drift=0.0, turn_drift=0.0, gain=0.0, gain_drift=0.0,
        shift=0.0, pixel_noise=0.0,
    )  # fmt: skip
    errors = []
    for seed in range(10):
        rig = RandomRig(prediction, SITES, only_model, np.random.default_rng(seed))
        capture = rig.start()
        own = np.nonzero(rig.prediction.power)[1]
        offset = np.radians([-10.0, 0.0, 10.0])
        light = np.log(rig.prediction.unit(rig.prediction.phi[:, None] + offset))
        healthy = capture("", 0)[0]
        for fiber in range(20):
            turned = capture("10 deg off", fiber)[0]
            change = np.log(turned[fiber, :, own[fiber]] / healthy[fiber, :, own[fiber]])
            off = change - (light[fiber, [0, 2]] - light[fiber, 1])
            # Which way a rig's fiber turns is its own secret; the other way fits far worse.
            errors.append(min(off, key=lambda one: float(np.mean(one**2))))
    record = rig_tolerances(sweep=True, starts=STARTS, noise=np.array(0.0))
    only_turn = RigTolerances(model=0.0, model_turned=record.model_turned)
    expected = only_turn.model_when_turned(np.radians([10.0]))[0]
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(expected, rel=0.08)


def test_where_a_fiber_points_as_recorded_only_its_drift_is_left() -> None:
    record = rig_tolerances(sweep=True, starts=STARTS, noise=np.array(0.0))
    assert record.model_when_turned(np.zeros(1))[0] == record.model


def test_the_model_alone_errs_alike_in_every_direction() -> None:
    alone = rig_tolerances(sweep=True, starts=0, noise=np.array(0.0))
    assert np.ptp(alone.model_when_turned(np.radians([0.0, 10.0, -30.0]))) == 0.0
