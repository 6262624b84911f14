"""What `tactilux hw calibrate` writes about powers is used by the commands after it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from hw.calibrated_powers import calibrated_powers
from hw.emulator.emulated_board import EmulatedBoard
from hw.errors import CalibrationError
from optimize.design import Design, save_design
from render.scene import load_scene
from tests.conftest import Run

SCENE = load_scene("finger20")
POWER = np.linspace(0.8, 1.2, 20)


def written(path: Path, scene_hash: str = SCENE.hash, **other: object) -> Path:
    """Write as much of a calibration as is read."""
    content = {
        "scene_hash": {"before": scene_hash, "after": "0" * 16},
        "power": POWER.tolist(),
        "power_error": (0.0196 * POWER).tolist(),
    }
    path.write_text(json.dumps(content | other))
    return path


def test_all_fibers_are_dimmed_to_the_weakest_that_is_lit(tmp_path: Path) -> None:
    found = calibrated_powers(written(tmp_path / "c.json"), None, SCENE.hash, 20)
    assert found is not None
    drive = np.zeros((20, 3))
    drive[5:, 1] = 1.0
    evened = found.evened(drive)
    np.testing.assert_allclose(evened[5:, 1] * POWER[5:], POWER[5])
    assert evened[5, 1] == 1.0
    assert not evened[:5].any()
    np.testing.assert_allclose(found.error, 0.01)


def test_a_fiber_that_was_not_photographed_is_taken_as_the_mean(tmp_path: Path) -> None:
    some = [None, *POWER[1:].tolist()]
    path = written(tmp_path / "c.json", power=some, power_error=some)
    found = calibrated_powers(path, None, SCENE.hash, 20)
    assert found is not None
    assert (found.power[0], found.error[0]) == (1.0, 0.08)


def test_one_beside_the_design_is_found_if_it_is_of_the_same_scene(tmp_path: Path) -> None:
    design = tmp_path / "design.json"
    assert calibrated_powers(None, design, SCENE.hash, 20) is None
    written(tmp_path / "calibration.json")
    assert calibrated_powers(None, design, SCENE.hash, 20) is not None
    assert calibrated_powers(None, design, "1" * 16, 20) is None


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("{}", "is not a calibration.json"),
        ("[1]", "is not a calibration.json"),
        ("\x00", "is not a calibration.json"),
        (None, "is not a calibration.json"),
    ],
)
def test_a_file_that_is_none_raises_one_clear_error(
    tmp_path: Path, content: str | None, said: str
) -> None:
    path = tmp_path / "c.json"
    if content is not None:
        path.write_text(content)
    with pytest.raises(CalibrationError, match=said):
        calibrated_powers(path, None, SCENE.hash, 20)


def test_one_of_another_scene_is_refused_where_it_is_named(tmp_path: Path) -> None:
    path = written(tmp_path / "c.json", scene_hash="f" * 16)
    with pytest.raises(CalibrationError, match="calibration of another scene"):
        calibrated_powers(path, None, SCENE.hash, 20)


def test_hw_set_evens_the_powers_out(tactilux: Run, tmp_path: Path) -> None:
    save_design(tmp_path / "design.json", Design.of_colors(np.full(20, np.pi / 2), [0] * 20), SCENE)
    path = written(tmp_path / "calibration.json")
    with EmulatedBoard(tmp_path / "port") as board:
        said = tactilux("hw", "set", tmp_path / "design.json", "--port", board.port,
                        "--seconds", "0")  # fmt: skip
    assert said.code == 0, said.err
    assert f"evened out by {path}" in said.err
    current = 20 * float(np.sum(POWER[0] / POWER))
    assert f"20 of 20 fibers lit, {current:.0f} mA" in said.err
