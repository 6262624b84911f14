"""Emulated boards behind real serial ports."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from hw.emulator.board import EmulatedBoard
from hw.emulator.faults import Faults
from hw.leds.ports import ProtocolName

Plug = Callable[..., EmulatedBoard]


@pytest.fixture
def plug(tmp_path: Path) -> Iterator[Plug]:
    """Plug emulated boards in; they are unplugged after the test."""
    with ExitStack() as stack:

        def one(protocol: str = "lines", leds: int = 20, **faults: object) -> EmulatedBoard:
            wrong = Faults(**faults)  # type: ignore[arg-type]
            board = EmulatedBoard(tmp_path / "port", ProtocolName(protocol), leds, wrong)
            return stack.enter_context(board)

        yield one
