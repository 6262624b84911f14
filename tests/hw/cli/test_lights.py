"""``tactilux hw set | sweep | off`` on an emulated board."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from hw.emulator.emulated_board import EmulatedBoard
from hw.leds import ProtocolName
from hw.leds.ports import open_board
from optimize.design import Design, save_design
from render.scene import load_scene
from tests.conftest import Run

SCENE = load_scene("finger20")


@pytest.fixture
def design(tmp_path: Path) -> Path:
    """Write a design whose fibers are red, green and blue in turn."""
    colors = (np.arange(20) % 3).tolist()
    save_design(tmp_path / "design.json", Design.of_colors(np.full(20, np.pi / 2), colors), SCENE)
    return tmp_path / "design.json"


@pytest.fixture(params=[name.value for name in ProtocolName])
def board(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[EmulatedBoard]:
    """Plug in a board of each protocol."""
    with EmulatedBoard(tmp_path / "port", ProtocolName(request.param)) as plugged:
        plugged.name = request.param  # type: ignore[attr-defined]
        yield plugged


def seen_while(board: EmulatedBoard, work: threading.Event) -> list[np.ndarray]:
    seen = []
    while not work.wait(0.01):
        seen.append(board.levels)
    return seen


def test_set_lights_the_design_and_ends_dark(
    tactilux: Run, board: EmulatedBoard, design: Path
) -> None:
    done, seen = threading.Event(), []
    watcher = threading.Thread(target=lambda: seen.extend(seen_while(board, done)))
    watcher.start()
    result = tactilux("hw", "set", design, "--port", board.port, "--protocol", board.name,  # type: ignore[attr-defined]
                      "--seconds", "1.0")  # fmt: skip
    done.set()
    watcher.join()
    assert result.code == 0, result.err
    assert "All LEDs are off" in result.out
    wanted = (255 * np.eye(3)[np.arange(20) % 3]).astype(np.uint8)
    assert any(np.array_equal(levels, wanted) for levels in seen)
    assert board.wait_for(np.zeros((20, 3), dtype=np.uint8))


def test_sweep_names_every_fiber(tactilux: Run, board: EmulatedBoard, design: Path) -> None:
    result = tactilux("hw", "sweep", design, "--port", board.port, "--protocol", board.name,  # type: ignore[attr-defined]
                      "--seconds", "0")  # fmt: skip
    assert result.code == 0, result.err
    lines = result.out.splitlines()
    assert lines[3] == "fiber 3, LED 3: red"
    assert len(lines) == 21


def test_off_darkens_a_board_that_another_program_left_on(
    tactilux: Run, board: EmulatedBoard
) -> None:
    speech = ProtocolName(board.name)  # type: ignore[attr-defined]
    left = open_board(str(board.port), speech, leds=20)
    left.show(np.full((20, 3), 9, dtype=np.uint8))
    left.close()
    assert board.wait_for(np.full((20, 3), 9, dtype=np.uint8))
    result = tactilux("hw", "off", "--port", board.port, "--protocol", speech.value)
    assert result.code == 0, result.err
    assert board.wait_for(np.zeros((20, 3), dtype=np.uint8))


def test_a_fiber_whose_level_rounds_to_dark_is_not_said_to_be_lit(
    tactilux: Run, tmp_path: Path, design: Path
) -> None:
    with EmulatedBoard(tmp_path / "port") as board:
        result = tactilux("hw", "set", design, "--port", board.port, "--scale", "0.001",
                          "--seconds", "0")  # fmt: skip
    assert result.code == 0, result.err
    assert "0 of 20 fibers lit" in result.err


def test_ports_are_listed_for_programs(tactilux: Run) -> None:
    result = tactilux("hw", "ports", "--json")
    assert result.code == 0
    assert isinstance(json.loads(result.out)["ports"], list)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--port", "/dev/none"), "plug the board in"),
        (("--port", "/dev/null"), "not a serial port"),
        (("--leds", "0,1"), "list of 20 numbers"),
        (("--order", "xyz"), "correct --order"),
        (("--limit-ma", "100"), "400 mA, allowed: 100 mA"),
    ],
)
def test_what_cannot_be_lit_raises_one_clear_error(
    tactilux: Run, design: Path, tmp_path: Path, arguments: tuple[str, ...], said: str
) -> None:
    with EmulatedBoard(tmp_path / "port") as board:
        result = tactilux("hw", "set", design, "--port", board.port, *arguments)
    assert result.code == 2
    assert said in result.err
    assert result.err.count("\n") == 1
    assert not board.levels.any()
