"""``tactilux hw emulate``: an LED board without hardware, for other commands to talk to."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import IO, TYPE_CHECKING, Annotated

from typer import Option

from hw.cli.options import SpokenProtocol
from hw.leds import ProtocolName
from optimize.ui.console import note, reserved_stdout

if TYPE_CHECKING:
    from hw.leds.board import Levels

LOOK_SECONDS = 0.05
"""Seconds between two looks at the LEDs."""
COLOR_NAMES = {"FF0000": "red", "00FF00": "green", "0000FF": "blue", "FFFFFF": "white"}


def run(
    port: Annotated[Path, Option(help="Where the board's serial port is to appear: a new name.")],
    protocol: SpokenProtocol = ProtocolName.LINES,
    leds: Annotated[int, Option(min=1, max=512, help="LEDs that the board drives.")] = 20,
) -> None:
    """Be an LED board for other commands, until Ctrl-C."""
    from hw.emulator.emulated_board import EmulatedBoard
    from hw.errors import PortError

    with reserved_stdout() as stream:
        if port.is_symlink() or port.exists():
            raise PortError(
                f"{port} is there already: give --port a name that is free, or remove it",
                field="port",
            )
        try:
            board = EmulatedBoard(port, protocol, leds)
        except OSError as error:
            raise PortError(
                f"{port} cannot be made ({error.strerror}): give --port another place", field="port"
            ) from None
        with board:
            spoken = "" if protocol is ProtocolName.LINES else f" --protocol {protocol}"
            note(
                f"A board with {leds} LEDs is on {port} until Ctrl-C. In another shell: "
                f"tactilux hw set design.json --port {port}{spoken}"
            )
            _watch(board.port, stream, lambda: board.levels)


def _watch(port: Path, stream: IO[str], look: Callable[[], Levels]) -> None:
    """Write what the LEDs show whenever that changes."""
    said = None
    while port.is_symlink():
        levels = look()
        told = shown(levels)
        if told != said:
            stream.write(told + "\n")
            stream.flush()
            said = told
        time.sleep(LOOK_SECONDS)


def shown(levels: Levels) -> str:
    """Return which LEDs are lit, with their colors.

    >>> import numpy as np
    >>> shown(np.array([[255, 0, 0], [0, 0, 0], [0, 128, 7]], dtype=np.uint8))
    '2 of 3 LEDs lit: 0 red, 2 #008007'
    """
    lit = {led: bytes(color).hex().upper() for led, color in enumerate(levels) if color.any()}
    if not lit:
        return "All LEDs are dark."
    named = (f"{led} {COLOR_NAMES.get(color, '#' + color)}" for led, color in lit.items())
    return f"{len(lit)} of {len(levels)} LEDs lit: {', '.join(named)}"
