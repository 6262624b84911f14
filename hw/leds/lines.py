"""The plain line protocol: how lines are framed and checked. Its page is in ``hw/README.md``.

A request is ``<number> <word> <arguments>*<checksum>``, its one answer ``<number> OK*<checksum>``
or ``<number> ERR <reason>*<checksum>``; the checksum is CRC-8 of all that stands before the star,
as two hexadecimal digits.
"""

from __future__ import annotations

from hw.errors import ProtocolError

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
            value=line[:40],
        )
    return text
