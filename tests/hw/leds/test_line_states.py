"""A line board that does not show what it was told is refused, and an older one is not believed."""

from __future__ import annotations

import os
import pty
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from hw.emulator.emulated_board import EmulatedBoard
from hw.errors import HardwareError, PortError, ProtocolError
from hw.leds import ProtocolName
from hw.leds.adalight_board import AdalightBoard
from hw.leds.board import Board, Levels, dark
from hw.leds.line_board import LineBoard, framed
from hw.leds.link import SerialLink
from hw.leds.ports import open_board
from hw.leds.wled_board import WledBoard
from hw.leds.wled_link import SerialWled

COLORS: Levels = np.random.default_rng(0).integers(1, 255, (20, 3)).astype(np.uint8)


@contextmanager
def board_in(folder: Path, state: str) -> Iterator[tuple[LineBoard, EmulatedBoard]]:
    with EmulatedBoard(folder / "port", state=state) as rig:
        board = open_board(str(rig.port), ProtocolName.LINES, leds=20)
        yield board, rig  # type: ignore[misc]
        board.close()


def test_a_board_that_dims_is_refused(tmp_path: Path) -> None:
    with board_in(tmp_path, "dimmed") as (board, rig):
        with pytest.raises(ProtocolError, match=r"LED 0 .* shows \[.*\], allowed: \[.*brightness"):
            board.show(COLORS)
        board.show(dark(20))
        assert not rig.levels.any()


def test_a_board_whose_supply_collapses_is_refused(tmp_path: Path) -> None:
    with board_in(tmp_path, "collapsing") as (board, rig):
        few = COLORS.copy()
        few[6:] = 0
        board.show(few)
        np.testing.assert_array_equal(rig.levels, few)
        with pytest.raises(ProtocolError, match=r"shows \[0, 0, 0\].*see that its supply holds"):
            board.show(COLORS)


def test_a_board_that_starts_anew_while_the_light_is_held_is_noticed(tmp_path: Path) -> None:
    with board_in(tmp_path, "") as (board, rig):
        board.show(COLORS)
        board.keep_alive()
        rig._firmware = rig.boot()
        with pytest.raises(ProtocolError, match=r"shows \[0, 0, 0\]"):
            board.keep_alive()


def test_firmware_without_read_back_lights_and_says_so(tmp_path: Path) -> None:
    with board_in(tmp_path, "version-1") as (board, rig):
        board.show(COLORS)
        board.keep_alive()
        np.testing.assert_array_equal(rig.levels, COLORS)
        assert "version 1 does not say; flash the firmware" in board.unread
    with board_in(tmp_path, "") as (board, _):
        assert not board.unread


def test_leds_beyond_those_of_the_fibers_go_dark(tmp_path: Path) -> None:
    with EmulatedBoard(tmp_path / "port", leds=30) as rig:
        board = open_board(str(rig.port), ProtocolName.LINES, leds=20)
        board.show(np.full((30, 3), 9, dtype=np.uint8))
        board.show(dark(20))
        board.show(COLORS)
        np.testing.assert_array_equal(rig.levels, np.concatenate([COLORS, dark(10)]))
        board.close()


@contextmanager
def line(answers: Callable[[bytes], bytes]) -> Iterator[SerialLink]:
    """Open a line on which somebody gives ``answers``."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    stop = threading.Event()

    def serve() -> None:
        while not stop.is_set():
            try:
                answer = answers(os.read(master, 4096))
                while answer and not stop.is_set():
                    answer = answer[os.write(master, answer) :]
            except OSError:
                return

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    link = SerialLink(os.ttyname(slave), timeout=0.2)
    try:
        yield link
    finally:
        stop.set()
        link.close()
        os.close(slave)
        os.close(master)


@pytest.mark.parametrize(
    "identity",
    [
        "tactilux-led,2,x,99999999999",
        "tactilux-led,2,x," + 5000 * "9",
        "tactilux-led,2,\x1b[2Jx,20",
        "tactilux-led,2," + 200 * "x" + ",20",
        "tactilux-led,2,x,-3",
        "tactilux-led,2,x,0",
        "tactilux-led,2,x",
        "tactilux-led,999,x,20",
        "tactilux-led,2.5,x,20",
    ],
)
def test_an_identity_that_cannot_be_is_refused(identity: str) -> None:
    with line(lambda _: framed(identity)) as link, pytest.raises(PortError) as told:
        LineBoard(link, start_seconds=0.15)
    assert str(told.value).isprintable()
    assert len(str(told.value)) < 300


@pytest.mark.parametrize("added", ["", " ", " ff", " GG0000", " FF000", " 255 0 0"])
def test_a_read_back_that_means_nothing_is_refused(added: str) -> None:
    def answers(request: bytes) -> bytes:
        if b"*IDN?" in request:
            return framed("tactilux-led,2,x,1")
        number, word, *_ = request.decode().split("*")[0].split(" ")
        return framed(f"{number} OK{added if word == 'GET' else ''}")

    with line(answers) as link:
        board = LineBoard(link)
        with pytest.raises(HardwareError, match="flash the firmware"):
            board.show(np.array([[255, 0, 0]], dtype=np.uint8))


OPENED: dict[str, Callable[[SerialLink], Board]] = {
    "lines": lambda link: LineBoard(link, start_seconds=0.2),
    "wled": lambda link: WledBoard(SerialWled(link), start_seconds=0.2),
    "adalight": lambda link: AdalightBoard(link, 20, start_seconds=0.2),
}


@pytest.mark.parametrize("flood", [b"no\n", b"{}\n", b"[0]\n", b"[" * 3000 + b"\n", b"x"])
@pytest.mark.parametrize("protocol", sorted(OPENED))
def test_a_line_that_never_falls_silent_ends_in_time(protocol: str, flood: bytes) -> None:
    with line(lambda _: 60_000 // len(flood) * flood) as link:
        link.write(b"\n")
        began = time.monotonic()
        with pytest.raises(HardwareError):
            OPENED[protocol](link)
        assert time.monotonic() - began < 2.0
