"""A WLED that does not show what it was told is refused by the name of what differs."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from hw.emulator.emulated_board import EmulatedBoard
from hw.emulator.wled_firmware import WLED_STATES, WledFirmware
from hw.errors import ProtocolError
from hw.leds import ProtocolName
from hw.leds.board import Board, Levels, dark
from hw.leds.ports import open_board
from hw.leds.wled_state import differences, field_of
from tests.hw.wled_server import wled_server

COLORS: Levels = np.random.default_rng(0).integers(1, 255, (20, 3)).astype(np.uint8)
PURE: Levels = (255 * np.eye(3)[np.arange(20) % 3]).astype(np.uint8)

REFUSED = {
    "factory": r"cfg.light.gc.col = 2.8, allowed: 1; switch gamma correction",
    "limiter": r"info.leds.pwr = 2\d\d.0, allowed: below maxpwr = 250 mA; give the limiter",
    "live": r"info.live = 'E1.31 from 192.168.1.9', allowed: False; end the program",
    "gamma": r"cfg.light.gc.col = 2.8",
    "brightness-factor": r"cfg.light.scale-bri = 50, allowed: 100",
    "white-balance": r"cfg.hw.led.cct = True, allowed: False",
    "automatic-white": r"cfg.hw.led.ins.rgbwm = 2.0, allowed: 0",
    "off": r"state.on = False, allowed: True",
    "dim": r"state.bri = 128, allowed: 255",
    "transition": r"state.transition = 7, allowed: 0",
    "nightlight": r"state.nl.on = True, allowed: False; switch its timer",
    "playlist": r"state.pl = 1, allowed: -1; end the playlist",
    "ledmap": r"state.ledmap = 1, allowed: 0",
    "panel": r"info.leds.matrix = .*allowed: a chain",
    "white-leds": r"info.leds.lc = 2",
    "short-segment": r"seg.stop = 10.0, allowed: 20 or more; .* one segment",
    "late-segment": r"seg.start = 1, allowed: 0",
    "second-segment": r"state.seg = 'a second segment, 1', allowed: one",
    "no-segment": r"state.seg = \[\], allowed: a segment 0",
    "segment-off": r"seg.on = False, allowed: True",
    "segment-dim": r"seg.bri = 64, allowed: 255",
    "thawed": r"seg.frz = False, allowed: True",
    "grouped": r"seg.grp = 2, allowed: 1",
    "spaced": r"seg.spc = 1, allowed: 0",
    "offset": r"seg.of = 3, allowed: 0",
    "reversed": r"seg.rev = True, allowed: False",
    "mirrored": r"seg.mi = True, allowed: False",
    "old": r"seg.frz = None, allowed: True; update WLED to 0.13 or later",
}
SHOWN = {"override", "bare", "pin"}
"""States in which all the light is there; ``pin`` keeps WLED from telling so."""
UNTOLD_OVER_USB = {"brightness-factor", "white-balance", "automatic-white"}
HOLDS_LIGHT = {"live"}
"""States that no request can darken."""


@contextmanager
def serial_board(folder: Path, state: str) -> Iterator[tuple[Board, EmulatedBoard]]:
    with EmulatedBoard(folder / "port", ProtocolName.WLED, state=state) as rig:
        board = open_board(str(rig.port), ProtocolName.WLED, leds=20)
        yield board, rig
        board.close()


def test_every_state_of_the_emulated_board_is_judged() -> None:
    assert set(REFUSED) | SHOWN == set(WLED_STATES)


@pytest.mark.parametrize("state", sorted(REFUSED))
def test_over_the_network_every_difference_is_refused_by_its_name(state: str) -> None:
    with wled_server(state=state) as server:
        board = open_board(server.address, ProtocolName.WLED, leds=20)
        with pytest.raises(ProtocolError, match=REFUSED[state]):
            board.show(COLORS)


@pytest.mark.parametrize("state", sorted(set(REFUSED) - UNTOLD_OVER_USB))
def test_over_usb_every_difference_is_refused_by_its_name(tmp_path: Path, state: str) -> None:
    gamma = r"LED 0 \(red, green, blue, white\) = .*; switch gamma correction"
    said = gamma if state in ("gamma", "factory") else REFUSED[state]
    with serial_board(tmp_path, state) as (board, _), pytest.raises(ProtocolError, match=said):
        board.show(COLORS)


@pytest.mark.parametrize("state", sorted(UNTOLD_OVER_USB))
def test_what_wled_does_not_tell_over_usb_is_said_to_be_unread(tmp_path: Path, state: str) -> None:
    with serial_board(tmp_path, state) as (board, _):
        board.show(COLORS)
        assert "brightness factor, white balance" in board.unread


@pytest.mark.parametrize("state", ["", *sorted(SHOWN)])
def test_what_is_not_refused_is_shown(tmp_path: Path, state: str) -> None:
    with wled_server(state=state) as server:
        board = open_board(server.address, ProtocolName.WLED, leds=20)
        board.show(COLORS)
        np.testing.assert_array_equal(server.shown, COLORS)
        assert bool(board.unread) == (state == "pin")
    with serial_board(tmp_path, state) as (board, rig):
        board.show(COLORS)
        np.testing.assert_array_equal(rig.levels, COLORS)


@pytest.mark.parametrize(
    ("version", "margin"), [("0.13.3", 60), ("0.14.4", 60), ("16.0.1", 2), ("0.15.5", 240)]
)
def test_a_long_string_near_its_limit_is_shown_and_a_dimmed_one_is_not(
    version: str, margin: int
) -> None:
    levels = np.full((200, 3), 100, dtype=np.uint8)
    wanted = int(100 + 200 + 200 * 100 / 255 * 55)
    for limit, dimmed in ((wanted + margin, False), (wanted - 20, True)):
        firmware = WledFirmware(200, {"info.ver": version, "cfg.hw.led.maxpwr": limit})
        segment = {"id": 0, "on": True, "bri": 255, "i": [0, 200, "646464"]}
        request = {"on": True, "bri": 255, "transition": 0, "seg": segment}
        firmware.take(json.dumps(request).encode() + b"\n", 0.0)
        pages = {name: cast("dict[str, Any]", firmware.page(name)) for name in ("state", "info")}
        found = list(differences(levels, pages, cast("dict[str, Any]", firmware.page("cfg"))))
        assert [one.field for one in found] == ["info.leds.pwr"] * dimmed


def test_gamma_and_an_unused_limiter_leave_full_levels_alone() -> None:
    with wled_server(state="factory") as server:
        board = open_board(server.address, ProtocolName.WLED, leds=20)
        board.show(PURE)
        np.testing.assert_array_equal(server.shown, PURE)


@pytest.mark.parametrize("state", ["", *sorted(WLED_STATES)])
def test_dark_is_dark_in_every_state_or_refused(state: str) -> None:
    with wled_server(state=state) as server:
        board = open_board(server.address, ProtocolName.WLED, leds=20)
        if state in HOLDS_LIGHT:
            with pytest.raises(ProtocolError, match=r"info\.live"):
                board.show(dark(20))
        else:
            board.show(dark(20))
            assert not server.shown.any()


def test_leds_beyond_those_of_the_fibers_go_dark() -> None:
    with wled_server(leds=30) as server:
        board = open_board(server.address, ProtocolName.WLED, leds=20)
        board.show(np.full((30, 3), 9, dtype=np.uint8))
        board.show(COLORS)
        np.testing.assert_array_equal(server.shown, np.concatenate([COLORS, dark(10)]))


def test_a_string_longer_than_a_request_is_shown_whole() -> None:
    levels = np.random.default_rng(1).integers(0, 9, (150, 3)).astype(np.uint8)
    with wled_server(leds=200) as server:
        board = open_board(server.address, ProtocolName.WLED, leds=150)
        board.show(levels)
        np.testing.assert_array_equal(server.shown[:150], levels)


def test_a_change_while_the_light_is_held_is_noticed() -> None:
    with wled_server() as server:
        board = open_board(server.address, ProtocolName.WLED, leds=20)
        board.show(COLORS)
        board.keep_alive()
        server.firmware.take(b'{"bri":90}\n', 0.0)
        with pytest.raises(ProtocolError, match=r"state\.bri = 90"):
            board.keep_alive()


WRONG: list[object] = [None, True, -1, 1e300, 10**400, "\x1b[2J", [], {}, [{}], [[0]], [None]]


@pytest.mark.parametrize("value", WRONG, ids=[str(one)[:8] for one in range(len(WRONG))])
def test_wrong_types_in_any_place_are_compared_and_never_a_traceback(value: object) -> None:
    firmware = WledFirmware(20)
    pages = {name: firmware.page(name) for name in ("state", "info", "cfg")}
    for path in paths(pages):
        parent, _, name = path.rpartition(".")
        changed = {key: WledFirmware(20).page(key) for key in pages}
        place = field_of(changed, parent) if parent else changed
        if name in ("state", "info") or not isinstance(place, dict):
            continue
        place[name] = value
        answer = {key: changed[key] for key in ("state", "info")}
        settings = changed["cfg"] if isinstance(changed["cfg"], dict) else {}
        for difference in differences(COLORS, answer, settings):
            assert str(difference).isprintable()
            assert len(str(difference)) < 400


def paths(tree: object, before: str = "") -> Iterator[str]:
    """Yield the paths of all fields."""
    if isinstance(tree, dict):
        for name, value in tree.items():
            yield before + name
            yield from paths(value, f"{before}{name}.")
