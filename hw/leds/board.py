"""What every LED board can do, whatever it speaks."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Levels = NDArray[np.uint8]
"""What the LEDs show: ``(led, 3)`` red, green, blue, 0 to 255."""


MOST_LEDS = 65536
"""A board that says it drives more is not believed."""


class Board(Protocol):
    """An open LED board that has said who it is.

    name: what the board calls itself. leds: number of LEDs it drives.
    dark_after: seconds after which it goes dark by itself when it hears nothing, None if never.
    unread: what nobody can ask it about what it shows, "" where all was read back.
    """

    name: str
    leds: int
    dark_after: float | None
    unread: str

    def show(self, levels: Levels) -> None:
        """Show ``levels`` ``(led, 3)``, all other LEDs dark; return once this was read back.

        Raises:
            LinkError: no answer in time, or the cable was pulled.
            ProtocolError: the board refused, or shows something else.
        """

    def keep_alive(self) -> None:
        """Let the board hear from us, and see that it still shows what it was told.

        Raises:
            LinkError, ProtocolError: as `show`.
        """

    def close(self) -> None:
        """Give the port back; the light stays as it is."""


def dark(leds: int) -> Levels:
    """Return levels ``(led, 3)`` with all LEDs off."""
    return np.zeros((leds, 3), dtype=np.uint8)
