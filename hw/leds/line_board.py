"""A board that speaks the plain line protocol: one acknowledgement per line, a watchdog."""

from __future__ import annotations

import time

from hw.errors import LinkError, PortError, ProtocolError, UnpluggedError
from hw.leds.board import Levels
from hw.leds.lines import IDENTITY_REQUEST, MAKER, NUMBERS, VERSION, framed, unframed
from hw.leds.link import SerialLink

START_SECONDS = 3.0
"""How long a board may take to start: opening the port resets many of them."""
TRIES = 3
"""How often a request is sent before the link counts as lost; every request may be repeated."""
DARK_AFTER = 2.0
"""Seconds without a request after which the board turns all LEDs off."""


class LineBoard:
    """The driver of `hw/firmware/tactilux_led`.

    Arguments:
        link: an open serial line; the board takes it over.
        start_seconds: how long the board may take to say who it is.
    """

    def __init__(self, link: SerialLink, *, start_seconds: float = START_SECONDS) -> None:
        """Ask who is there and start the watchdog.

        Raises:
            PortError: nobody answers, or something else is connected.
        """
        self._link = link
        self._number = 0
        self.dark_after: float | None = DARK_AFTER
        self.name, self.leds = self._identity(start_seconds)
        self._request(f"WDT {round(1000 * DARK_AFTER)}")

    def show(self, levels: Levels) -> None:
        """Set every LED, then latch all of them at once."""
        for led, (red, green, blue) in enumerate(levels.tolist()):
            self._request(f"SET {led} {red} {green} {blue}")
        self._request("SHOW")

    def keep_alive(self) -> None:
        """Feed the watchdog."""
        self._request("PING")

    def close(self) -> None:
        """Give the port back."""
        self._link.close()

    def _identity(self, patience: float) -> tuple[str, int]:
        """Return name and number of LEDs."""
        deadline = time.monotonic() + patience
        heard = b""
        while time.monotonic() < deadline:
            self._link.forget()
            self._link.write(IDENTITY_REQUEST)
            answer_by = min(time.monotonic() + 0.5, deadline)
            try:
                while True:
                    line = self._link.read_line(answer_by)
                    heard = line or heard
                    found = _identity_in(line)
                    if found is not None:
                        return found
            except UnpluggedError:
                raise
            except (LinkError, ProtocolError):
                continue
        told = f"said {heard[:40]!r}" if heard else "said nothing"
        raise PortError(
            f"what is connected to {self._link.port} {told} when asked *IDN?, so it is no "
            "tactilux-led board: choose another --port or --protocol",
            field="port",
            value=self._link.port,
        )

    def _request(self, words: str) -> None:
        """Send one request until it is acknowledged.

        Raises:
            LinkError: no acknowledgement in `TRIES` tries.
            ProtocolError: the board refuses the request, or all its answers are damaged.
        """
        self._number = (self._number + 1) % NUMBERS
        failure: LinkError | ProtocolError | None = None
        for _ in range(TRIES):
            self._link.write(framed(f"{self._number} {words}"))
            deadline = time.monotonic() + self._link.timeout
            try:
                while not self._acknowledged(self._link.read_line(deadline), words):
                    pass
                return
            except UnpluggedError:
                raise
            except LinkError as error:
                # A damaged answer tells more than the silence after it.
                failure = failure if isinstance(failure, ProtocolError) else error
            except _Damaged as error:
                failure = error
        assert failure is not None
        raise failure

    def _acknowledged(self, line: bytes, words: str) -> bool:
        """Return whether ``line`` answers the last request; late answers to others do not."""
        try:
            number, _, answer = unframed(line).partition(" ")
        except ProtocolError as error:
            raise _Damaged(str(error), field="line", value=line[:40]) from None
        # A damaged request has no number that could be trusted.
        if answer == "ERR checksum":
            raise _Damaged(
                f"requests reach the LED board on {self._link.port} damaged: shorten the cable or "
                "lower --baud",
                field="line",
            )
        if number != str(self._number):
            return False
        if answer == "OK":
            return True
        raise ProtocolError(
            f"the LED board refused {words!r} with {answer[:40]!r}, allowed: OK; flash the "
            "firmware that comes with this version",
            field="answer",
            value=answer[:40],
            allowed="OK",
        )


class _Damaged(ProtocolError):
    """A line that arrived damaged; worth another try."""


def _identity_in(line: bytes) -> tuple[str, int] | None:
    """Return name and LEDs of ``tactilux-led,<version>,<name>,<leds>``, None if it is not that.

    Raises:
        PortError: a board of another version.
    """
    try:
        maker, version, name, leds = unframed(line).split(",")
    except (ProtocolError, ValueError):
        return None
    if maker != MAKER:
        return None
    if version != str(VERSION):
        raise PortError(
            f"the LED board speaks version {version} of the line protocol, allowed: {VERSION}; "
            "flash the firmware that comes with this version",
            field="version",
            value=version,
            allowed=str(VERSION),
        )
    return (name, int(leds)) if leds.isdecimal() and int(leds) > 0 else None
