"""What the emulated board does wrong, on purpose."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class BoardFaults:
    """Faults to inject; counted down as they happen, so that a driver can be seen to recover.

    Arguments:
        silent: so many answers are swallowed.
        partial: so many answers are cut in the middle, without a line end.
        garbage: before so many answers come bytes that mean nothing.
        wrong: so many answers acknowledge another request than the one that was made.
        corrupt: so many requests arrive with a flipped bit.
        unplug_after: bytes after which the cable is pulled, in the middle of a frame.
        refuse: every request is refused with this reason.
    """

    silent: int = 0
    partial: int = 0
    garbage: int = 0
    wrong: int = 0
    corrupt: int = 0
    unplug_after: int | None = None
    refuse: str = ""

    def take(self, name: str) -> bool:
        """Return whether the fault happens now, and count it."""
        left = int(getattr(self, name))
        if left > 0:
            setattr(self, name, left - 1)
        return left > 0
