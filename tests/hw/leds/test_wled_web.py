"""WLED over the network: a real HTTP exchange with a server that speaks its JSON API."""

from __future__ import annotations

import time

import numpy as np
import pytest

from hw.errors import LinkError, PortError
from hw.leds import ProtocolName
from hw.leds.board import Levels, dark
from hw.leds.ports import open_board
from hw.leds.wled_board import WledBoard
from hw.leds.wled_link import WebWled
from tests.hw.wled_server import wled_server

COLORS: Levels = np.random.default_rng(0).integers(0, 256, (20, 3)).astype(np.uint8)


def test_the_controller_shows_what_it_is_told() -> None:
    with wled_server() as server:
        board = open_board(server.address + "/", ProtocolName.WLED, leds=20)
        assert (board.name, board.leds) == ("WLED 0.14.0", 20)
        board.show(COLORS)
        np.testing.assert_array_equal(server.shown, COLORS)
        board.keep_alive()
        board.show(dark(20))
        assert not server.shown.any()
        assert set(server.posts) == {"/json/state"}
        board.close()


def test_a_controller_that_is_busy_once_is_asked_again() -> None:
    with wled_server() as server:
        board = open_board(server.address, ProtocolName.WLED, leds=20)
        server.refuse = 1
        board.show(COLORS)
        np.testing.assert_array_equal(server.shown, COLORS)


def test_a_controller_that_goes_away_raises_one_clear_error() -> None:
    with wled_server() as server:
        board = open_board(server.address, ProtocolName.WLED, leds=20)
    with pytest.raises(LinkError, match="check its power and network"):
        board.show(COLORS)


def test_too_few_leds_raise_one_clear_error() -> None:
    with wled_server(leds=4) as server, pytest.raises(PortError, match="drives 4 LEDs"):
        open_board(server.address, ProtocolName.WLED, leds=20)


@pytest.mark.parametrize("address", ["http://", "http:///json", "https://"])
def test_what_is_no_address_raises_one_clear_error(address: str) -> None:
    with pytest.raises(PortError, match="not the address of a WLED"):
        open_board(address, ProtocolName.WLED, leds=20)


def test_other_protocols_are_not_spoken_over_a_network() -> None:
    with pytest.raises(PortError, match="add --protocol wled"):
        open_board("http://127.0.0.1:9", ProtocolName.LINES, leds=20)


def test_an_address_where_nobody_listens_is_told_after_the_start_up_time() -> None:
    began = time.monotonic()
    with pytest.raises(PortError, match="no WLED answers on http"):
        WledBoard(WebWled("http://127.0.0.1:9"), start_seconds=0.3)
    assert 0.3 <= time.monotonic() - began < 3.0
