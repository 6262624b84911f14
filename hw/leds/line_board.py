"""A board that speaks the plain line protocol, whose page is in ``hw/README.md``.

A request is ``<number> <word> <arguments>*<checksum>``, its one answer ``<number> OK*<checksum>``
or ``<number> ERR <reason>*<checksum>``; the checksum is CRC-8 of all that stands before the star,
as two hexadecimal digits. A watchdog turns the LEDs off in silence. Since version 2 the board says
what its LEDs show.
"""

from __future__ import annotations

import time

from hw.errors import LinkError, PortError, ProtocolError, UnpluggedError
from hw.leds.board import MOST_LEDS, Levels, dark
from hw.leds.link import SerialLink

IDENTITY_REQUEST = b"*IDN?\n"
MAKER = "tactilux-led"
VERSION = 2
READ_BACK = 2
"""The first version that knows ``GET``."""
LONGEST_NAME = 40
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
        self._version, self.name, self.leds = self._identity(start_seconds)
        self.unread = (
            ""
            if self._version >= READ_BACK
            else f"what its LEDs show, which firmware of version {self._version} does not say; "
            "flash the firmware that comes with this version"
        )
        self._shown = dark(self.leds)
        self._request(f"WDT {round(1000 * DARK_AFTER)}")

    def show(self, levels: Levels) -> None:
        """Set every LED, then latch all of them at once."""
        if levels.any():
            for led, (red, green, blue) in enumerate(levels.tolist()):
                self._request(f"SET {led} {red} {green} {blue}")
            self._request("SHOW")
        else:
            self._request("OFF")
        self._shown = levels.copy()
        if self._version >= READ_BACK:
            self._compare()

    def keep_alive(self) -> None:
        """Feed the watchdog, and see that the LEDs still show what they were told."""
        if self._version >= READ_BACK:
            self._compare()
        else:
            self._request("PING")

    def _compare(self) -> None:
        """Read back what the LEDs show.

        Raises:
            ProtocolError: something else than they were told.
        """
        shown: list[tuple[int, ...]] = []
        while len(shown) < len(self._shown):
            shown += _colors_in(self._request(f"GET {len(shown)}"))
        for led, (asked, read) in enumerate(zip(self._shown.tolist(), shown, strict=False)):
            if asked != list(read):
                raise ProtocolError(
                    f"LED {led} of {self.name} on {self._link.port} shows {list(read)}, allowed: "
                    f"{asked}, as it was told; see that its supply holds, as a board that starts "
                    "anew is dark, and that its sketch sets no brightness",
                    field="led",
                )

    def close(self) -> None:
        """Give the port back."""
        self._link.close()

    def _identity(self, patience: float) -> tuple[int, str, int]:
        """Return version, name and number of LEDs."""
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

    def _request(self, words: str) -> str:
        """Send one request until it is acknowledged; return what the answer adds to ``OK``.

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
                while (added := self._added(self._link.read_line(deadline), words)) is None:
                    pass
                return added
            except UnpluggedError:
                raise
            except LinkError as error:
                # A damaged answer tells more than the silence after it.
                failure = failure if isinstance(failure, ProtocolError) else error
            except _Damaged as error:
                failure = error
        assert failure is not None
        raise failure

    def _added(self, line: bytes, words: str) -> str | None:
        """Return what ``line`` adds to ``OK``, None where it answers another request than ours."""
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
            return None
        ok, _, added = answer.partition(" ")
        if ok == "OK" and bool(added) == words.startswith("GET "):
            return added
        raise ProtocolError(
            f"the LED board refused {words!r} with {answer[:40]!r}, allowed: OK; flash the "
            "firmware that comes with this version",
            field="answer",
        )


class _Damaged(ProtocolError):
    """A line that arrived damaged; worth another try."""


def _colors_in(text: str) -> list[tuple[int, ...]]:
    """Return the colors of at least one LED, six hexadecimal digits each.

    >>> _colors_in("FF000000007F")
    [(255, 0, 0), (0, 0, 127)]

    Raises:
        ProtocolError: it is anything else.
    """
    try:
        levels = list(bytes.fromhex(text))
        if not levels:
            raise ValueError("no color")
        return list(zip(*[iter(levels)] * 3, strict=True))
    except ValueError:
        raise ProtocolError(
            f"the LED board answers GET with {text[:40]!r}, allowed: six hexadecimal digits for "
            "each LED; flash the firmware that comes with this version",
            field="answer",
        ) from None


def _identity_in(line: bytes) -> tuple[int, str, int] | None:
    """Return version, name and LEDs of ``tactilux-led,<version>,<name>,<leds>``.

    None if it is not that.

    Raises:
        PortError: a board of another version.
    """
    try:
        maker, version, name, leds = unframed(line).split(",")
        count = int(leds)
    except (ProtocolError, ValueError):
        return None
    named = name.isprintable() and len(name) <= LONGEST_NAME
    if maker != MAKER or not named or not 1 <= count <= MOST_LEDS:
        return None
    if version not in {str(one) for one in range(1, VERSION + 1)}:
        raise PortError(
            f"the LED board speaks version {version[:40]!r} of the line protocol, allowed: 1 to "
            f"{VERSION}; flash the firmware that comes with this version",
            field="version",
        )
    return int(version), name, count
