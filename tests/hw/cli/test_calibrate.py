"""``tactilux hw calibrate`` and ``linearity`` tell what they cannot use in one sentence."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from hw.cli.capture import only_light
from optimize.design import baseline_design, save_design
from render.scene import RGB, load_scene
from tests.conftest import Run
from tests.hw.cli.conftest import ROOT

SIZE = (360, 600)


def sweep(folder: Path, gamma: float = 1.0, together: bool = True) -> Path:
    """Write a sweep of three overlapping fibers, as a camera with ``gamma`` takes it."""
    folder.mkdir()
    y, x = np.mgrid[0 : SIZE[1], 0 : SIZE[0]] / 360.0
    light = [60 * np.exp(-3 * ((x - a) ** 2 + (y - 0.8) ** 2)) for a in (0.2, 0.5, 0.8)]

    def save(name: str, part: np.ndarray) -> None:
        encoded = np.rint(255 * (part / 255) ** (1 / gamma)).astype(np.uint8)
        Image.fromarray(np.repeat(encoded[..., None], 3, 2)).save(folder / f"{name}.png")

    for fiber, part in enumerate(light):
        save(f"fiber-{fiber:02d}", part)
    if together:
        save("all", np.sum(light, axis=0))
    return folder


def test_a_linear_camera_is_said_to_be_linear(tactilux: Run, tmp_path: Path) -> None:
    result = tactilux("hw", "linearity", sweep(tmp_path / "a"), "--noise", "0.3", "--json")
    assert result.code == 0, result.err
    assert json.loads(result.out)["cause"] == "none"


def test_a_gamma_is_an_error_until_it_is_given(tactilux: Run, tmp_path: Path) -> None:
    folder = sweep(tmp_path / "a", gamma=2.2)
    result = tactilux("hw", "linearity", folder, "--noise", "0.3")
    assert result.code == 2
    assert "--gamma" in result.err
    assert tactilux("hw", "linearity", folder, "--noise", "1", "--gamma", "2.2").code == 0


def test_calibration_refuses_a_gamma(tactilux: Run, tmp_path: Path) -> None:
    folder = sweep(tmp_path / "a", gamma=2.2)
    result = tactilux("hw", "calibrate", "--flat", folder, "--bent", folder,
                      "--linearity", folder, "--noise", "0.3")  # fmt: skip
    assert result.code == 2
    assert "light does not add up" in result.err
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--flat", "none", "--bent", "none"), "not a folder"),
        (("--flat", "plain", "--bent", "plain"), "no photograph of all fibers together"),
        (("--flat", "plain", "--bent", "plain", "--scene", "none"), "there is no scene"),
        (
            ("--flat", "plain", "--bent", "plain", "--red", "plain"),
            "1 of --red, --green and --blue are given, allowed: all or none",
        ),
        (("--flat", "plain"), "scene finger20 bends, allowed: --flat and --bent"),
        (
            ("--flat", "plain", "--bent", "plain", "--scene", "digit"),
            "scene digit is rigid, allowed: --flat alone",
        ),
    ],
)
def test_what_cannot_be_calibrated_raises_one_clear_error(
    tactilux: Run, tmp_path: Path, arguments: tuple[str, ...], said: str
) -> None:
    sweep(tmp_path / "plain", together=False)
    result = tactilux("hw", "calibrate", *arguments, "--linearity", "plain")
    assert result.code == 2
    assert said in result.err
    assert result.err.count("\n") == 1


def test_calibration_without_a_test_of_linearity_is_refused_before_anything_is_loaded() -> None:
    code = (
        "import sys; sys.argv = ['tactilux', 'hw', 'calibrate', '--flat', 'x', '--bent', 'x']\n"
        "from hw.cli import main\n"
        "try: main()\n"
        "except SystemExit as end: print(end.code, *sys.modules)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    )
    said, *loaded = done.stdout.split()
    assert said == "2"
    assert "--linearity" in done.stderr
    assert "hw.calibration" not in loaded
    assert "scipy" not in loaded


def test_help_says_that_calibration_needs_a_test_of_linearity(tactilux: Run) -> None:
    said = tactilux("hw", "calibrate", "--help").out
    assert "[required]" in said.partition("--linearity")[2].partition("--bent ")[0]


def test_a_capture_in_a_color_that_no_led_has_raises_one_clear_error(
    tactilux: Run, tmp_path: Path
) -> None:
    scene = load_scene("digit")
    save_design(tmp_path / "design.json", baseline_design(scene), scene)
    result = tactilux("hw", "capture", tmp_path / "design.json", "--scene", "digit",
                      "--color", "pink", "--out", tmp_path / "pink")  # fmt: skip
    assert result.code == 2
    assert "--color is pink, allowed: red, green, blue" in result.err
    assert not (tmp_path / "pink").exists()


def test_the_light_of_a_capture_is_white_or_one_color() -> None:
    assert only_light(0.5, None, RGB.names).tolist() == [0.5, 0.5, 0.5]
    assert only_light(None, "green", RGB.names).tolist() == [0.0, 1.0, 0.0]
    assert only_light(0.15, "blue", RGB.names).tolist() == [0.0, 0.0, 0.15]
