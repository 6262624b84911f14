"""``tactilux hw emulate`` in one process, and the other commands against it in another."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from hw.leds import ProtocolName
from optimize.design import Design, baseline_design, save_design
from render.scene import load_scene
from tests.conftest import Run
from tests.hw.palettes import rig_scene

ROOT = Path(__file__).parents[3]


@contextmanager
def emulated(port: Path, *options: str) -> Iterator[subprocess.Popen[str]]:
    """Run the command until the block ends."""
    process = subprocess.Popen(
        [sys.executable, "-m", "hw.cli", "hw", "emulate", "--port", str(port), *options],
        cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        # Tests that a shell runs in its background would hand on that Ctrl-C is ignored.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip
    assert process.stdout is not None
    try:
        assert process.stdout.readline() == "All LEDs are dark.\n"
        yield process
    finally:
        process.kill()
        process.communicate()


def design(folder: Path) -> Path:
    """Write a design of red, green and blue in turn."""
    colors = (np.arange(20) % 3).tolist()
    whole = Design.of_colors(np.full(20, np.pi / 2), colors)
    save_design(folder / "design.json", whole, load_scene("finger20"))
    return folder / "design.json"


@pytest.mark.parametrize("protocol", [name.value for name in ProtocolName])
def test_other_commands_light_it_and_ctrl_c_ends_it(
    tactilux: Run, tmp_path: Path, protocol: str
) -> None:
    port = tmp_path / "ttyLED"
    with emulated(port, "--protocol", protocol) as process:
        lit = tactilux("hw", "set", design(tmp_path), "--port", port, "--protocol", protocol,
                       "--fiber", "7", "--seconds", "0.3")  # fmt: skip
        assert lit.code == 0, lit.err
        # Only the line protocol says of everything what the LEDs show.
        lit_or_told = "lit" if protocol == "lines" else "told to light"
        assert f"1 of 20 fibers {lit_or_told}, 20 mA" in lit.err
        assert process.stdout is not None
        assert process.stdout.readline() == "1 of 20 LEDs lit: 7 green\n"
        assert process.stdout.readline() == "All LEDs are dark.\n"
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=20)
        assert process.returncode == 130
        assert f"20 LEDs is on {port} until Ctrl-C" in err
        assert "Traceback" not in err
    assert not port.is_symlink()


def test_a_fiber_that_the_design_leaves_dark_raises_one_clear_error(
    tactilux: Run, tmp_path: Path
) -> None:
    with emulated(tmp_path / "port"):
        said = tactilux("hw", "set", design(tmp_path), "--port", tmp_path / "port", "--fiber", "20")
    assert said.code == 2
    assert "--fiber 20 is not lit by this design, allowed: one of [0, 1" in said.err
    assert said.err.count("\n") == 1


@pytest.mark.parametrize(("name", "said"), [("taken", "is there already"), ("no/port", "No such")])
def test_a_port_that_cannot_be_made_raises_one_clear_error(
    tactilux: Run, tmp_path: Path, name: str, said: str
) -> None:
    (tmp_path / "taken").touch()
    result = tactilux("hw", "emulate", "--port", tmp_path / name)
    assert result.code == 2
    assert said in result.err
    assert result.err.count("\n") == 1
    assert (tmp_path / "taken").read_bytes() == b""


def test_a_state_of_the_board_is_refused_by_the_other_commands(
    tactilux: Run, tmp_path: Path
) -> None:
    options = ("--protocol", "wled", "--state", "short-segment")
    with emulated(tmp_path / "port", *options):
        lit = tactilux("hw", "set", design(tmp_path), "--port", tmp_path / "port",
                       "--protocol", "wled", "--seconds", "0")  # fmt: skip
    assert lit.code == 2
    assert "seg.stop = 10.0, allowed: 20 or more" in lit.err
    assert lit.err.count("\n") == 1


@pytest.mark.parametrize("protocol", [name.value for name in ProtocolName])
def test_a_state_that_a_board_cannot_have_raises_one_clear_error(
    tactilux: Run, tmp_path: Path, protocol: str
) -> None:
    result = tactilux("hw", "emulate", "--port", tmp_path / "port", "--protocol", protocol,
                      "--state", "tired")  # fmt: skip
    assert result.code == 2
    assert f"--state tired is none of a {protocol} board, allowed: " in result.err
    assert result.err.count("\n") == 1


def test_colors_are_those_of_the_scene(tactilux: Run, tmp_path: Path) -> None:
    path, port = rig_scene(tmp_path, "white and infrared, gray camera"), tmp_path / "port"
    scene = load_scene(path)
    save_design(tmp_path / "design.json", baseline_design(scene), scene)
    with emulated(port, "--scene", str(path)) as process:
        lit = tactilux("hw", "set", tmp_path / "design.json", "--port", port, "--seconds", "0.3")
        assert lit.code == 0, lit.err
        assert process.stdout is not None
        said = process.stdout.readline()
    assert said == "3 of 3 LEDs lit: 0 white, 1 infrared, 2 white\n"
