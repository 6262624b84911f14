"""A board that speaks the plain line protocol, whose page is in ``hw/README.md``.

A request is ``<number> <word> <arguments>*<checksum>``, its one answer ``<number> OK*<checksum>``
or ``<number> ERR <reason>*<checksum>``; the checksum is CRC-8 of all that stands before the star,
as two hexadecimal digits. A watchdog turns the LEDs off in silence.
"""

from __future__ import annotations

import time

from hw.errors import LinkError, PortError, ProtocolError, UnpluggedError
from hw.leds.board import Levels
from hw.leds.link import SerialLink

IDENTITY_REQUEST = b"*IDN?\n"
MAKER = "tactilux-led"
VERSION = 1
NUMBERS = 256
"""Requests are numbered modulo this, so that a late answer is not taken for the next one."""


def crc8(content: bytes) -> int:
    """Return CRC-8 with polynomial x^8 + x^2 + x + 1 (0x07) and start 0, as SMBus has it.

    >>> hex(crc8(b"123456789"))
    '0xf4'
    """
    crc = 0
    for byte in content:
        crc ^= byte
        for _ in range(8):
            crc = (crc << 1) ^ (0x07 if crc & 0x80 else 0)
        crc &= 0xFF
    return crc


def framed(body: str) -> bytes:
    r"""Return ``body`` with its checksum and line end.

    >>> framed("7 OFF")
    b'7 OFF*80\n'
    """
    content = body.encode("ascii")
    return content + b"*%02X\n" % crc8(content)


def unframed(line: bytes) -> str:
    """Return the body of a line without its end.

    Raises:
        ProtocolError: no checksum, or a wrong one.
    """
    body, star, checksum = line.rpartition(b"*")
    try:
        stated = int(checksum, 16) if len(checksum) == 2 else -1
        text = body.decode("ascii")
    except ValueError:
        stated, text = -1, ""
    if not star or stated != crc8(body):
        raise ProtocolError(
            f"the LED board sent {line[:40]!r}, which has no valid checksum: shorten the cable or "
            "lower --baud",
            field="line",
        )
    return text


START_SECONDS = 3.0
"""How long a board may take to start: opening the port resets many of them."""
TRIES = 3
"""How often a request is sent before the link counts as lost; every request may be repeated."""
DARK_AFTER = 2.0
"""Seconds without a request after which the board turns all LEDs off."""


class LineBoard:
    """The driver of `hw/firmware/tactilux_led`.

    It takes the open ``link`` over.
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
            raise _Damaged(str(error), field="line") from None
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
        )
    return (name, int(leds)) if leds.isdecimal() and int(leds) > 0 else None
