"""LED boards over a serial line, one protocol per file, and the lights of the fibers."""

from enum import StrEnum


class ProtocolName(StrEnum):
    """What a board speaks."""

    LINES = "lines"
    WLED = "wled"
    ADALIGHT = "adalight"
