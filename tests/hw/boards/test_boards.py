"""Every driver lights a real serial port's board, recovers from noise, and names what it cannot."""

from __future__ import annotations

import os
import pty
import time
from pathlib import Path

import numpy as np
import pytest

from hw.boards.board import Levels, dark
from hw.boards.line_board import LineBoard
from hw.boards.link import SerialLink
from hw.boards.ports import ProtocolName, open_board
from hw.errors import LinkError, PortError, ProtocolError, UnpluggedError
from tests.hw.conftest import Plug

PROTOCOLS = [name.value for name in ProtocolName]
COLOURS: Levels = np.random.default_rng(0).integers(0, 256, (20, 3)).astype(np.uint8)


def opened(port: Path, protocol: str = "lines", **options: float) -> LineBoard:
    board = open_board(str(port), ProtocolName(protocol), leds=20, timeout=0.2, **options)  # type: ignore[arg-type]
    return board  # type: ignore[return-value]


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_the_board_shows_what_it_is_told(plug: Plug, protocol: str) -> None:
    rig = plug(protocol)
    board = opened(rig.port, protocol)
    board.show(COLOURS)
    assert rig.wait_for(COLOURS)
    board.show(dark(20))
    assert rig.wait_for(dark(20))
    board.close()


@pytest.mark.parametrize("protocol", ["lines", "wled"])
@pytest.mark.parametrize("fault", ["silent", "partial", "garbage", "corrupt"])
def test_one_fault_is_overcome(plug: Plug, protocol: str, fault: str) -> None:
    rig = plug(protocol)
    board = opened(rig.port, protocol)
    setattr(rig.faults, fault, 1)
    board.show(COLOURS)
    assert rig.wait_for(COLOURS)
    board.close()


def test_an_acknowledgement_of_another_request_does_not_count(plug: Plug) -> None:
    rig = plug()
    board = opened(rig.port)
    rig.faults.wrong = 100
    with pytest.raises(LinkError, match="did not answer"):
        board.show(COLOURS)
    board.close()


def test_a_refusal_is_told_at_once(plug: Plug) -> None:
    rig = plug()
    board = opened(rig.port)
    rig.faults.refuse = "overheated"
    with pytest.raises(ProtocolError, match="overheated"):
        board.show(COLOURS)
    board.close()


def test_lasting_noise_on_the_line_is_told_as_such(plug: Plug) -> None:
    rig = plug()
    board = opened(rig.port)
    rig.faults.corrupt = 100
    with pytest.raises(ProtocolError, match="shorten the cable"):
        board.show(COLOURS)
    board.close()


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_pulling_the_cable_in_the_middle_of_a_frame_is_noticed(plug: Plug, protocol: str) -> None:
    rig = plug(protocol)
    board = opened(rig.port, protocol)
    rig.faults.unplug_after = 150

    def show_for_a_while() -> None:
        # Without acknowledgements the loss shows at the next frame.
        for _ in range(50):
            board.show(COLOURS)
            time.sleep(0.01)

    with pytest.raises(UnpluggedError, match="gone"):
        show_for_a_while()
    board.close()


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_two_programs_cannot_share_a_port(plug: Plug, protocol: str) -> None:
    rig = plug(protocol)
    board = opened(rig.port, protocol)
    with pytest.raises(PortError, match="in use by another program"):
        opened(rig.port, protocol)
    board.show(COLOURS)
    assert rig.wait_for(COLOURS)
    board.close()


def test_a_silent_device_is_no_board() -> None:
    master, slave = pty.openpty()
    link = SerialLink(os.ttyname(slave), timeout=0.1)
    with pytest.raises(PortError, match=r"said nothing.*--protocol"):
        LineBoard(link, start_seconds=0.3)
    link.close()
    os.close(master)
    os.close(slave)


def test_a_board_of_another_protocol_is_recognised(plug: Plug) -> None:
    rig = plug("adalight")
    link = SerialLink(str(rig.port), timeout=0.1)
    with pytest.raises(PortError, match="no tactilux-led board"):
        LineBoard(link, start_seconds=1.3)
    link.close()


def test_too_few_leds_are_refused(plug: Plug) -> None:
    rig = plug(leds=8)
    with pytest.raises(PortError, match="drives 8 LEDs"):
        opened(rig.port)


@pytest.mark.parametrize(
    ("port", "said"),
    [
        ("/dev/there-is-none", "plug the board in"),
        ("/dev/null", "not a serial port"),
        ("/", "not a serial port"),
    ],
)
def test_what_is_no_port_is_one_sentence(port: str, said: str) -> None:
    with pytest.raises(PortError, match=said):
        SerialLink(port)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may open every port")
def test_a_forbidden_port_says_which_group_to_join(tmp_path: Path) -> None:
    port = tmp_path / "port"
    port.touch(mode=0)
    with pytest.raises(PortError, match="usermod"):
        SerialLink(str(port))


def test_the_watchdog_darkens_a_board_that_hears_nothing(plug: Plug) -> None:
    rig = plug()
    board = opened(rig.port)
    board.show(COLOURS)
    board._request("WDT 100")
    assert rig.wait_for(COLOURS)
    assert rig.wait_for(dark(20), 1.0)
    board.close()


def test_a_flood_without_line_ends_is_not_read_for_ever() -> None:
    master, slave = pty.openpty()
    link = SerialLink(os.ttyname(slave), timeout=0.1)
    for _ in range(4):
        os.write(master, b"x" * 3000)
    with pytest.raises((ProtocolError, LinkError)):
        link.read_line(time.monotonic() + 0.3)
    link.close()
    os.close(master)
    os.close(slave)
