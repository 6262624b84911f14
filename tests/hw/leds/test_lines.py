"""Lines carry a checksum that no flipped bit survives."""

from __future__ import annotations

import pytest

from hw.errors import ProtocolError
from hw.leds.line_board import crc8, framed, unframed


def test_what_is_framed_can_be_unframed() -> None:
    assert unframed(framed("12 SET 3 255 0 7").rstrip(b"\n")) == "12 SET 3 255 0 7"


def test_every_single_flipped_bit_is_noticed() -> None:
    line = framed("12 SET 3 255 0 7").rstrip(b"\n")
    for bit in range(8 * len(line)):
        damaged = bytearray(line)
        damaged[bit // 8] ^= 1 << bit % 8
        # A lower-case digit is the same checksum.
        if bytes(damaged).upper() == line:
            continue
        with pytest.raises(ProtocolError):
            unframed(bytes(damaged))


@pytest.mark.parametrize("line", [b"", b"7 OK", b"7 OK*", b"7 OK*G0", b"7 OK*123", b"\xff*00"])
def test_a_line_without_a_valid_checksum_is_refused(line: bytes) -> None:
    with pytest.raises(ProtocolError, match="checksum"):
        unframed(line)


def test_the_checksum_is_the_published_one() -> None:
    assert crc8(b"123456789") == 0xF4
