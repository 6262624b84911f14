"""The reference firmware itself, compiled for this machine, speaks the line protocol."""

from __future__ import annotations

import os
import pty
import shutil
import subprocess
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from hw.errors import ProtocolError
from hw.leds.board import Levels
from hw.leds.line_board import LineBoard, framed
from hw.leds.link import SerialLink

ROOT = Path(__file__).parents[2]
SKETCH = ROOT / "hw" / "firmware" / "tactilux_led"
COMPILER = shutil.which("g++")

pytestmark = pytest.mark.skipif(COMPILER is None, reason="no C++ compiler on this machine")


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Compile the sketch."""
    binary = tmp_path_factory.mktemp("firmware") / "board"
    here = Path(__file__).parent / "arduino"
    assert COMPILER is not None
    subprocess.run(
        [
            COMPILER,
            "-std=c++17",
            "-Wall",
            "-I",
            here,
            "-I",
            SKETCH,
            here / "main.cpp",
            "-o",
            binary,
        ],
        check=True,
    )
    return binary


Running = tuple[SerialLink, Callable[[], Levels]]


@pytest.fixture
def running(program: Path, tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Running]:
    """Run the board, dimmed where a test asks for it; give its line and what its LEDs show."""
    dimmed = {"BRIGHTNESS": str(getattr(request, "param", 255))}
    master, slave = pty.openpty()
    tty.setraw(slave)
    shown = tmp_path / "shown"
    shown.touch()
    child = subprocess.Popen(
        [program, str(master), shown], pass_fds=[master], env=os.environ | dimmed
    )
    link = SerialLink(os.ttyname(slave), timeout=0.5)

    def levels() -> Levels:
        last = shown.read_text().splitlines()[-1]
        return np.array([int(item) for item in last.split()], dtype=np.uint8).reshape(-1, 3)

    yield link, levels
    link.close()
    child.kill()
    child.wait()
    os.close(master)
    os.close(slave)


def test_the_driver_lights_its_leds(running: Running) -> None:
    link, levels = running
    board = LineBoard(link)
    assert (board.name, board.leds) == ("nano-ws2812", 20)
    wanted = np.random.default_rng(2).integers(0, 256, (20, 3)).astype(np.uint8)
    board.show(wanted)
    assert np.array_equal(levels(), wanted)


@pytest.mark.parametrize("running", [51], indirect=True)
def test_a_sketch_that_dims_is_refused(running: Running) -> None:
    link, levels = running
    board = LineBoard(link)
    with pytest.raises(ProtocolError, match=r"LED 0 .* \[51, 0, 39\], allowed: \[255, 0, 196"):
        board.show(np.tile(np.array([255, 0, 196], dtype=np.uint8), (20, 1)))
    assert (levels() == [51, 0, 39]).all()
    board.show(np.zeros((20, 3), dtype=np.uint8))
    assert not levels().any()


@pytest.mark.parametrize(
    ("request_line", "answer"),
    [
        (framed("9 SET 20 0 0 0"), b"9 ERR range"),
        (framed("9 SET 1 256 0 0"), b"9 ERR range"),
        (framed("9 SET 1 x 0 0"), b"9 ERR number"),
        (framed("9 SET 1 0 0"), b"9 ERR word"),
        (framed("9 FLASH"), b"9 ERR word"),
        (framed("9"), b"9 ERR word"),
        (framed("9 GET 18"), b"9 OK 000000000000"),
        (framed("9 GET 3"), b"9 OK " + 8 * b"000000"),
        (framed("9 GET 20"), b"9 ERR range"),
        (framed("9 GET -1"), b"9 ERR range"),
        (framed("9 GET"), b"9 ERR word"),
        (framed("9 GET 1 2"), b"9 ERR word"),
        (framed("9 GET x"), b"9 ERR number"),
        (b"9 OFF*00\n", b"9 ERR checksum"),
        (b"9 OFF\n", b"9 ERR checksum"),
        (b"*\n", b"0 ERR checksum"),
        (b"x" * 200 + b"\n" + framed("9 PING"), b"9 OK"),
        (framed("9 PING").replace(b"\n", b"\r\n"), b"9 OK"),
    ],
)
def test_every_line_has_one_answer(running: Running, request_line: bytes, answer: bytes) -> None:
    link, _ = running
    link.write(request_line)
    line = link.read_line(time.monotonic() + 2.0)
    assert line.rpartition(b"*")[0] == answer


def test_its_watchdog_turns_the_light_off(running: Running) -> None:
    link, levels = running
    board = LineBoard(link)
    board.show(np.full((20, 3), 50, dtype=np.uint8))
    board._request("WDT 100")
    deadline = time.monotonic() + 3.0
    while levels().any() and time.monotonic() < deadline:
        time.sleep(0.02)
    assert not levels().any()
