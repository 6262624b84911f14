"""Strangers' text as text: what steers a terminal is shown, not obeyed.

Names of files, sources of values and words of boards come from others. All that the program says
goes through `printable`, in the streams of `optimize.ui.process`; its own tables and bars, whose
colors steer the terminal on purpose, go around it with their words made printable before.
"""

from __future__ import annotations

import re
from typing import IO, Any

_STEERING = re.compile(
    r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u200b-\u200f\u2028-\u202e\u2060-\u2069\ufeff\udc80-\udc9f]"
)
"""Control characters but the tab and the end of a line, and what turns or hides text around it."""
_ENDS = re.compile(r"[\t\n]")


def printable(text: str) -> str:
    r"""Return ``text`` with characters that steer a terminal written out.

    >>> printable("a\x1b[31m\u202eb")
    'a\\x1b[31m\\u202eb'
    """
    return _STEERING.sub(_written_out, text)


def one_line(text: str) -> str:
    r"""Return `printable` text without ends of lines and tabs, which could look like words of ours.

    >>> one_line("a\nb")
    'a\\nb'
    """
    return _ENDS.sub(_written_out, printable(text))


def _written_out(found: re.Match[str]) -> str:
    character = found[0]
    if "\udc80" <= character <= "\udc9f":  # a byte that is no UTF-8
        return f"\\x{ord(character) - 0xDC00:02x}"
    return character.encode("unicode_escape").decode("ascii")


class Steered:
    """A stream for tables and bars of rich, past the gate of a stream of ours."""

    def __init__(self, stream: IO[str]) -> None:
        self._stream = stream
        self.write = getattr(stream, "write_steered", stream.write)

    def __getattr__(self, name: str) -> Any:
        """Everything else is the stream's own."""
        return getattr(self._stream, name)
