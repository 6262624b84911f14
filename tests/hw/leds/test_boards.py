"""Every driver lights a real serial port's board, recovers from noise, and names what it cannot."""

from __future__ import annotations

import grp
import os
import pty
import pwd
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pytest

from hw.errors import LinkError, PortError, ProtocolError, UnpluggedError
from hw.leds import ProtocolName
from hw.leds.board import Levels, dark
from hw.leds.line_board import LineBoard
from hw.leds.link import SerialLink
from hw.leds.ports import open_board
from tests.hw.conftest import Plug

PROTOCOLS = [name.value for name in ProtocolName]
ROOT = Path(__file__).parents[3]
COLORS: Levels = np.random.default_rng(0).integers(0, 256, (20, 3)).astype(np.uint8)


def opened(port: Path, protocol: str = "lines", **options: float) -> LineBoard:
    board = open_board(str(port), ProtocolName(protocol), leds=20, timeout=0.2, **options)  # type: ignore[arg-type]
    return board  # type: ignore[return-value]


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_the_board_shows_what_it_is_told(plug: Plug, protocol: str) -> None:
    rig = plug(protocol)
    board = opened(rig.port, protocol)
    board.show(COLORS)
    assert rig.wait_for(COLORS)
    board.show(dark(20))
    assert rig.wait_for(dark(20))
    board.close()


@pytest.mark.parametrize("protocol", ["lines", "wled"])
@pytest.mark.parametrize("fault", ["silent", "partial", "garbage", "corrupt"])
def test_one_fault_is_overcome(plug: Plug, protocol: str, fault: str) -> None:
    rig = plug(protocol)
    board = opened(rig.port, protocol)
    setattr(rig.faults, fault, 1)
    board.show(COLORS)
    assert rig.wait_for(COLORS)
    board.close()


def test_an_acknowledgement_of_another_request_does_not_count(plug: Plug) -> None:
    rig = plug()
    board = opened(rig.port)
    rig.faults.wrong = 100
    with pytest.raises(LinkError, match="did not answer"):
        board.show(COLORS)
    board.close()


@pytest.mark.parametrize("protocol", ["lines", "wled"])
@pytest.mark.parametrize("fault", ["silent", "partial"])
def test_a_board_that_stops_answering_raises_in_time(plug: Plug, protocol: str, fault: str) -> None:
    rig = plug(protocol)
    board = opened(rig.port, protocol)
    setattr(rig.faults, fault, 10_000)
    began = time.monotonic()
    with pytest.raises((LinkError, ProtocolError), match="LED board on"):
        board.show(COLORS)
    assert time.monotonic() - began < 5.0
    board.close()


def test_one_wrong_acknowledgement_is_overcome(plug: Plug) -> None:
    rig = plug()
    board = opened(rig.port)
    rig.faults.wrong = 1
    board.show(COLORS)
    assert rig.wait_for(COLORS)
    board.close()


def test_an_acknowledgement_of_less_light_raises_one_clear_error(plug: Plug) -> None:
    rig = plug("wled")
    board = opened(rig.port, "wled")
    rig.faults.refuse = "brightness limit"
    with pytest.raises(ProtocolError, match=r"state\.on = False, allowed: True"):
        board.show(COLORS)
    board.close()


def test_a_refusal_raises_at_once(plug: Plug) -> None:
    rig = plug()
    board = opened(rig.port)
    rig.faults.refuse = "overheated"
    with pytest.raises(ProtocolError, match="overheated"):
        board.show(COLORS)
    board.close()


def test_lasting_noise_on_the_line_raises_an_error_that_says_so(plug: Plug) -> None:
    rig = plug()
    board = opened(rig.port)
    rig.faults.corrupt = 100
    with pytest.raises(ProtocolError, match="shorten the cable"):
        board.show(COLORS)
    board.close()


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_pulling_the_cable_in_the_middle_of_a_frame_is_noticed(plug: Plug, protocol: str) -> None:
    rig = plug(protocol)
    board = opened(rig.port, protocol)
    rig.faults.unplug_after = 150

    def show_for_a_while() -> None:
        # Without acknowledgements the loss shows at the next frame.
        for _ in range(50):
            board.show(COLORS)
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
    board.show(COLORS)
    assert rig.wait_for(COLORS)
    board.close()


def test_another_program_cannot_take_the_port(plug: Plug) -> None:
    rig = plug()
    board = opened(rig.port)
    done = subprocess.run(
        [sys.executable, "-m", "hw.cli", "hw", "off", "--port", str(rig.port)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert "in use by another program: end that program first" in done.stderr
    assert done.stderr.count("\n") == 1
    board.show(COLORS)
    assert rig.wait_for(COLORS)
    board.close()


def test_a_silent_device_is_no_board() -> None:
    master, slave = pty.openpty()
    link = SerialLink(os.ttyname(slave), timeout=0.1)
    with pytest.raises(PortError, match=r"said nothing.*--protocol"):
        LineBoard(link, start_seconds=0.3)
    link.close()
    os.close(master)
    os.close(slave)


def test_a_board_of_another_protocol_is_recognized(plug: Plug) -> None:
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
        ("/dev/null", r"not a serial port that can be opened \(Inappropriate ioctl for device\)"),
        ("/", "not a serial port"),
    ],
)
def test_what_is_no_port_raises_one_clear_error(port: str, said: str) -> None:
    with pytest.raises(PortError, match=said):
        SerialLink(port)


def test_a_forbidden_port_says_which_group_to_join() -> None:
    who = os.geteuid()
    with tempfile.TemporaryDirectory() as folder:
        os.chmod(folder, 0o755)
        port = Path(folder) / "port"
        port.touch(mode=0)
        group = grp.getgrgid(port.stat().st_gid).gr_name
        if who == 0:
            # Root may open every port, so it is tried as somebody else.
            os.seteuid(pwd.getpwnam("nobody").pw_uid)
        try:
            with pytest.raises(PortError, match=rf"may not use .*usermod -a -G {group} \$USER"):
                SerialLink(str(port))
        finally:
            os.seteuid(who)


def test_the_watchdog_darkens_a_board_that_hears_nothing(plug: Plug) -> None:
    rig = plug()
    board = opened(rig.port)
    board.show(COLORS)
    board._request("WDT 100")
    assert rig.wait_for(COLORS)
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
