"""A WLED controller: its JSON API over the serial port (WLED 0.13 and later), or the network.

What it then does is read back and compared with what it was asked, field by field.
"""

from __future__ import annotations

import time
from typing import Any

from hw.errors import LinkError, PortError, ProtocolError, UnpluggedError
from hw.leds.board import MOST_LEDS, Levels, dark
from hw.leds.wled_link import WledLink
from hw.leds.wled_state import (
    SEGMENT,
    differences,
    field_of,
    number_at,
    pixel_differences,
    short,
    unread_of,
)  # fmt: skip

START_SECONDS = 5.0
"""How long a controller may take to start after the port's opening has reset it."""
LEDS_PER_REQUEST = 64
"""WLED reads requests into a small buffer; longer ones are dropped without a word."""
TRIES = 2
FRAME_SECONDS = 0.05
"""WLED shows what it was told, and reckons the current, in its next frame: 42 a second."""


class WledBoard:
    """The driver of WLED.

    It takes the ``link`` over.
    """

    def __init__(self, link: WledLink, *, start_seconds: float = START_SECONDS) -> None:
        """Ask who is there.

        Raises:
            PortError: nobody answers, or it is not WLED.
        """
        self._link = link
        self.dark_after: float | None = None
        self.unread = ""
        self._version, self.leds = self._identity(start_seconds)
        self.name = f"WLED {self._version}"
        self._settings = link.settings()
        self._tells_pixels = link.pixels() is not None
        self._shown = dark(self.leds)

    def show(self, levels: Levels) -> None:
        """Set every LED of the segment, the brightness full, and all others dark."""
        if levels.any():
            for first in range(0, len(levels), LEDS_PER_REQUEST):
                self._light(first, levels[first : first + LEDS_PER_REQUEST])
            if len(levels) < self.leds:
                self._set_pixels([len(levels), self.leds, "000000"])
        else:
            self._retried({"on": False, "transition": 0, "nl": {"on": False}})
        self._shown = levels.copy()
        time.sleep(FRAME_SECONDS)
        self.keep_alive()

    def keep_alive(self) -> None:
        """See that it still shows what it was told; WLED has no watchdog.

        Raises:
            ProtocolError: it shows something else.
        """
        answer = self._retried({})
        for difference in differences(self._shown, answer, self._settings):
            raise self._refused(difference)
        pixels = self._link.pixels() if self._tells_pixels and self._shown.any() else None
        for difference in pixel_differences(self._shown, pixels) if pixels is not None else ():
            raise self._refused(difference)
        self.unread = unread_of(self._shown, self._version, self._settings, pixels is not None)

    def close(self) -> None:
        """Give the port back."""
        self._link.close()

    def _light(self, first: int, levels: Levels) -> None:
        """Show ``levels`` ``(led, 3)`` from LED ``first`` on."""
        colors = [f"{red:02X}{green:02X}{blue:02X}" for red, green, blue in levels.tolist()]
        self._set_pixels([first, *colors])

    def _set_pixels(self, pixels: list[object]) -> None:
        self._retried(
            {
                "on": True,
                "bri": 255,
                "transition": 0,
                "nl": {"on": False},
                "seg": {"id": SEGMENT, "on": True, "bri": 255, "i": pixels},
            }
        )

    def _refused(self, difference: object) -> ProtocolError:
        return ProtocolError(
            f"WLED on {self._link.port} does not show what it was told: {difference}",
            field="state",
        )

    def _retried(self, request: dict[str, object]) -> dict[str, Any]:
        for remaining in reversed(range(TRIES)):
            try:
                return self._link.ask(request, self._link.timeout)
            except UnpluggedError:
                raise
            except LinkError:
                if not remaining:
                    raise
        raise AssertionError("unreachable")

    def _identity(self, patience: float) -> tuple[str, int]:
        """Return version and number of LEDs."""
        deadline = time.monotonic() + patience
        reason = "nobody answers"
        while (remaining := deadline - time.monotonic()) > 0:
            try:
                info = self._link.ask({}, min(remaining, 1.0))["info"]
            except UnpluggedError:
                raise
            except (LinkError, ProtocolError) as error:
                # A network without a controller refuses at once.
                said = str(error).removeprefix(f"the LED board on {self._link.port} ")
                reason = said.rpartition(": ")[0]
                time.sleep(min(0.05, remaining))
                continue
            version, count = info.get("ver"), number_at(info, "leds.count")
            if _is_version(version) and count is not None and 1 <= count <= MOST_LEDS:
                return version, int(count)
            counted = short(field_of(info, "leds.count"))
            reason = f"ver = {short(version)}, leds.count = {counted}"
        raise PortError(
            f"no WLED answers on {self._link.port} ({reason}): choose another --port or "
            "--protocol, and see that the controller has power and, for a serial port, that serial "
            "is on in its sync settings",
            field="port",
        )


def _is_version(found: object) -> bool:
    return isinstance(found, str) and found.isascii() and found.isprintable() and len(found) <= 40
