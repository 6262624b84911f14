"""Adalight frames: the simplest of all, understood by many sketches and by WLED.

A frame is ``Ada``, the number of LEDs less one (two bytes, high first), these two bytes and 0x55
combined by XOR, then red, green, blue of every LED. Nothing is acknowledged: a board says ``Ada``
on a line of its own when it starts and about every second while it hears nothing.
"""

from __future__ import annotations

import time

import numpy as np

from hw.errors import LinkError, PortError, ProtocolError, UnpluggedError
from hw.leds.board import Levels, dark
from hw.leds.link import SerialLink

START_SECONDS = 4.0
"""How long a board may take to say ``Ada``."""


def adalight_frame(levels: Levels) -> bytes:
    """Return the frame that shows ``levels`` ``(led, 3)``.

    >>> adalight_frame(np.array([[255, 0, 1]], dtype=np.uint8)).hex(" ")
    '41 64 61 00 00 55 ff 00 01'
    """
    high, low = divmod(len(levels) - 1, 256)
    return b"Ada" + bytes([high, low, high ^ low ^ 0x55]) + levels.astype(np.uint8).tobytes()


class AdalightBoard:
    """The driver of Adalight sketches.

    It takes the open ``link`` over; the board cannot say itself how many ``leds`` it drives.
    """

    def __init__(
        self, link: SerialLink, leds: int, *, start_seconds: float = START_SECONDS
    ) -> None:
        """Wait for the board's ``Ada``.

        Raises:
            PortError: it does not come.
        """
        self._link = link
        self.leds = leds
        self.name = "Adalight"
        self.dark_after: float | None = None
        self.unread = "everything, as such boards answer nothing"
        self._last = dark(leds)
        deadline = time.monotonic() + start_seconds
        try:
            while not self._link.read_line(deadline).endswith(b"Ada"):
                pass
        except UnpluggedError:
            raise
        except (LinkError, ProtocolError):
            raise PortError(
                f"nothing on {link.port} says Ada, so it is no Adalight board: choose another "
                "--port or --protocol",
                field="port",
            ) from None

    def show(self, levels: Levels) -> None:
        """Send one frame."""
        self._link.forget()
        self._link.write(adalight_frame(levels))
        self._last = levels.copy()

    def keep_alive(self) -> None:
        """Send the last frame again: sketches go dark, or back to their own show, in silence."""
        self.show(self._last)

    def close(self) -> None:
        """Give the port back."""
        self._link.close()
