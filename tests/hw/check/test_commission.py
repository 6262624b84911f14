"""The record of a healthy rig is complete, or refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hw.check.commission import commission, load_record
from hw.check.prediction import PadPrediction
from hw.check.rig_tolerances import rig_tolerances
from hw.check.sweep_check import check_sweep
from hw.errors import CaptureError
from render.errors import TableError
from render.files import write_npz
from render.scene import load_scene

SCENE = load_scene("finger20")


def test_a_record_holds_the_measured_ratio(prediction: PadPrediction, tmp_path: Path) -> None:
    error = np.exp(0.1 * np.random.default_rng(1).standard_normal((20, 15)))
    colors = 3.0 * prediction.alone * error[..., None]
    commission(prediction, colors, SCENE, 0.0).save(tmp_path / "rig.npz")
    record = load_record(tmp_path / "rig.npz")
    ratio = record.ratio / error
    # The gains are medians, so only the overall factor is free.
    for color in range(3):
        own = ratio[prediction.power[:, color] > 0]
        np.testing.assert_allclose(own, own.mean(), rtol=1e-9)
    record.check_fits(prediction, SCENE, 0.0)


def test_records_of_several_starts_average_what_drifts(
    prediction: PadPrediction, tmp_path: Path
) -> None:
    rng = np.random.default_rng(2)
    true = np.exp(0.1 * rng.standard_normal((20, 15)))
    record = None
    for start in range(4):
        drift = np.exp(0.02 * rng.standard_normal((20, 15)))
        own = commission(prediction, prediction.alone * (true * drift)[..., None], SCENE, 0.0)
        record = own if record is None else record.joined(own)
        assert record.starts == start + 1
    assert record is not None
    record.save(tmp_path / "rig.npz")
    kept = load_record(tmp_path / "rig.npz")
    assert kept.starts == 4
    # Gains are medians, so only the overall factor is free; half the drift of one start is left.
    for color in range(3):
        own = np.log(kept.ratio / true)[prediction.power[:, color] > 0]
        assert np.std(own) == pytest.approx(0.01, rel=0.15)


def test_a_record_holds_what_channels_see_of_other_colors(
    prediction: PadPrediction, tmp_path: Path
) -> None:
    response = np.array([[1.0, 0.06, 0.01], [0.08, 1.0, 0.05], [0.0, 0.07, 1.0]])
    colors = replace(prediction, response=response).alone * np.array([2.0, 3.0, 1.5])
    one = commission(prediction, colors, SCENE, 0.0)
    one.joined(one).save(tmp_path / "rig.npz")
    kept = load_record(tmp_path / "rig.npz")
    np.testing.assert_allclose(kept.response, response, atol=0.01)
    np.testing.assert_allclose(kept.ratio, 1.0, atol=0.02)


@pytest.mark.parametrize(
    ("scene", "bend", "said"), [("finger24", 0.0, "another scene"), ("finger20", 1.0, "bend of 0")]
)
def test_a_record_of_something_else_is_refused(
    prediction: PadPrediction, scene: str, bend: float, said: str
) -> None:
    record = commission(prediction, prediction.alone, SCENE, 0.0)
    with pytest.raises(CaptureError, match=said):
        record.check_fits(prediction, load_scene(scene), bend)


def test_a_rig_with_a_dead_fiber_is_not_recorded(prediction: PadPrediction) -> None:
    colors = prediction.alone.copy()
    colors[4] = 0.0
    with pytest.raises(CaptureError, match="fiber 4"):
        commission(prediction, colors, SCENE, 0.0)


def test_rubbish_is_no_record(tmp_path: Path) -> None:
    (tmp_path / "a.npz").write_bytes(b"rubbish")
    with pytest.raises(TableError):
        load_record(tmp_path / "a.npz")
    write_npz(tmp_path / "b.npz", {"ratio": np.ones((2, 2))})
    with pytest.raises(CaptureError, match="--commission"):
        load_record(tmp_path / "b.npz")


def test_a_rig_of_one_fiber_in_each_color_is_healthy_at_its_next_start(
    prediction: PadPrediction,
) -> None:
    power = np.zeros((20, 3))
    power[:3] = np.eye(3)
    few = replace(prediction, power=power)
    response = np.array([[1.0, 0.06, 0.07], [0.02, 1.0, 0.05], [0.0, 0.07, 1.0]])
    light = few.unit(few.phi[:, None])[:, 0, :, None] * (power @ response)[:, None]
    # What was built differs from the design by more than a start from the next.
    healthy = light * np.array([1.4, 0.9, 0.7] + [1.0] * 17)[:, None, None]
    record = commission(few, healthy, SCENE, 0.0)
    known = replace(few, response=record.response)
    tolerances = rig_tolerances(sweep=True, starts=1, noise=np.array(0.045))
    for drift in (1.03, 0.97):
        assert check_sweep(known, drift * healthy, tolerances, record.ratio).ok
