"""The commands of a rig on sensors with any LEDs and cameras of any number of channels."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from hw.emulator.rig import random_parameters
from render.scene import load_scene
from surrogate.preview_model import preview_checker
from tests.conftest import Run
from tests.hw.palettes import RESPONSES, matrix, rig_scene
from tests.long import LONG

FOUR = "amber, infrared and white, four channels"
WHITE, INFRARED = "white, gray camera", "white and infrared, gray camera"
AMBER = "white and amber, color camera"


@pytest.fixture(autouse=True)
def coarse(monkeypatch: pytest.MonkeyPatch) -> None:
    """Take the preview as drawn for the model: it is quick."""
    for place in ("optimize.scoring", "hw.calibration.calibration"):
        monkeypatch.setattr(
            f"{place}.open_model", lambda scene, *_, **__: preview_checker(scene, coarse=True)
        )


@pytest.mark.parametrize("name", RESPONSES)
def test_every_fault_of_an_emulated_rig_is_named_and_none_of_a_healthy_one(
    tactilux: Run, tmp_path: Path, name: str
) -> None:
    scene = rig_scene(tmp_path, name)
    # Without a record one healthy rig in twenty is unclear, that of seed 0 is one.
    result = tactilux("hw", "demo", "--scene", scene, "--no-calibrate", "--seed", "1",
                      "--keep", tmp_path / "kept", "--json")  # fmt: skip
    assert result.code == 0, result.err
    checks = json.loads(result.out)["checks"]
    found = {said: [fiber["state"] for fiber in one["fibers"]] for said, one in checks.items()}
    swapped = {"fiber 2 with swapped colors": ["ok", "ok", "swapped"]} if name != WHITE else {}
    assert found == {
        "healthy": ["ok", "ok", "ok"],
        "fiber 0 dead": ["dead", "ok", "ok"],
        "fiber 1 at half power": ["ok", "dim", "ok"],
        **swapped,
    }
    # And the commands for photographs in folders read them.
    kept = tmp_path / "kept"
    linear = tactilux("hw", "linearity", kept / "additive", "--scene", scene)
    assert "the camera is linear" in linear.out, linear.err
    record = tmp_path / "rig.npz"
    healthy = tactilux("check", scene, "--capture", kept / "commission", "--commission", record)
    assert healthy.code == 0, healthy.out + healthy.err
    dead = tactilux("check", scene, "--capture", kept / "fiber-0-dead", "--rig", record)
    assert dead.code == 1
    assert "Fiber 0 is dead" in dead.out


def test_the_faults_of_a_demonstration_are_those_of_lamps_that_the_design_lights(
    tactilux: Run, tmp_path: Path
) -> None:
    scene = rig_scene(tmp_path, AMBER, "gelsight-mini")
    scene.write_text(scene.read_text().replace('left = "white"', 'left = "off"'))
    options = ("--scene", scene, "--no-calibrate", "--rays", "20000")
    result = tactilux("hw", "demo", *options, "--keep", tmp_path / "kept")
    assert result.code == 0, result.err
    assert "Check, healthy: the rig looks as designed\n" in result.out
    assert "Check, fiber 4 dead: fiber 4 is dead" in result.out
    assert "Check, fiber 5 at half power: fiber 5 is dim" in result.out
    assert "Check, fiber 6 with swapped colors: fiber 6 has the wrong color" in result.out
    assert result.out.endswith("Fibers 0, 1, 2, 3 are not lit by the design.\n")
    assert not (tmp_path / "kept" / "commission" / "fiber-00.npy").exists()
    linear = tactilux("hw", "linearity", tmp_path / "kept" / "additive", "--scene", scene)
    assert "the camera is linear" in linear.out, linear.err


@pytest.mark.slow
@pytest.mark.parametrize("name", [INFRARED, AMBER, FOUR] if LONG else [FOUR])
def test_calibration_recovers_the_response_and_the_powers(
    tactilux: Run, tmp_path: Path, name: str
) -> None:
    path, out = rig_scene(tmp_path, name, "gelsight-mini"), tmp_path / "out"
    result = tactilux("hw", "demo", "--calibrate", "--scene", path, "--rig-samples", "300",
                      "--samples", "0", "--out", out, "--keep", tmp_path / "kept",
                      "--json")  # fmt: skip
    assert result.code == 0, result.err
    said, scene = json.loads(result.out), load_scene(path)
    assert all(check["ok"] == (one == "healthy") for one, check in said["checks"].items())
    for row in said["truth"][-matrix(name).size :]:
        assert row["found"] == pytest.approx(row["true"], abs=0.01), row
    true = random_parameters(scene, 0).power
    np.testing.assert_allclose(said["power"], true / true.mean(), rtol=0.05)
    assert len(said["gain"]) == len(said["channels"]) == len(scene.palette.channels)
    told = any("a photograph does not tell which LEDs" in caveat for caveat in said["caveats"])
    assert told == (name == INFRARED)
    after = load_scene(out / "scene.toml")
    assert after.palette.names == scene.palette.names
    # The same from the folders, color by color.
    kept = tmp_path / "kept"
    colors = [part for led in scene.palette.names
              for part in ("--color", f"{led}={kept / led}")]  # fmt: skip
    again = tactilux("hw", "calibrate", "--scene", path, "--flat", kept / "flat", *colors,
                     "--linearity", kept / "additive", "--samples", "0",
                     "--out", tmp_path / "again")  # fmt: skip
    assert again.code == 0, again.err
    assert f"{scene.palette.names[0]} LEDs are seen by: {scene.palette.channels[0]} " in again.out


@pytest.mark.parametrize(
    ("colors", "said"),
    [
        (["--color", "white=flat"], "1 of --color white= and --color amber= are given"),
        (["--color", "white"], "--color white is not like NAME=FOLDER"),
        (["--color", "white="], "--color white= is not like NAME=FOLDER"),
        (["--color", "pink=flat"], "pink is no LED color of the scene, allowed: white, amber"),
        (["--red", "flat"], "--red: red is no LED color of the scene"),
        (["--color", "white=a", "--color", "white=b"], "white is given twice"),
    ],
)
def test_sweeps_in_colors_that_do_not_fit_raise_one_clear_error(
    tactilux: Run, tmp_path: Path, colors: list[str], said: str
) -> None:
    scene = rig_scene(tmp_path, AMBER)
    result = tactilux("hw", "calibrate", "--scene", scene, "--flat", "flat",
                      "--linearity", "line", *colors)  # fmt: skip
    assert result.code == 2
    assert said in result.err
    assert result.err.count("\n") == 1


def test_photographs_of_another_camera_raise_one_clear_error(tactilux: Run, tmp_path: Path) -> None:
    scene = rig_scene(tmp_path, WHITE)
    (tmp_path / "flat").mkdir()
    np.save(tmp_path / "flat" / "fiber-00.npy", np.zeros((320, 240, 3)))
    for command in (
        ("check", scene, "--capture", tmp_path / "flat"),
        ("hw", "linearity", tmp_path / "flat", "--scene", scene),
        (
            "hw",
            "calibrate",
            "--flat",
            tmp_path / "flat",
            "--scene",
            scene,
            "--linearity",
            tmp_path / "flat",
        ),
    ):
        result = tactilux(*command)
        assert result.code == 2
        assert "has shape (320, 240, 3), allowed: (rows, columns, 1)" in result.err


def test_a_live_capture_of_four_channels_raises_one_clear_error(
    tactilux: Run, tmp_path: Path
) -> None:
    scene = rig_scene(tmp_path, FOUR)
    result = tactilux("check", scene, "--camera", "0", "--port", tmp_path / "none")
    assert result.code == 2
    assert "the scene's camera has 4 channels, allowed for a live one: 1 or 3" in result.err
