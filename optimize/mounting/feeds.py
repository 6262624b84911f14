"""Which LED feeds which fiber, and how much current it takes."""

from __future__ import annotations

from dataclasses import dataclass

FULL_MILLIAMPERES = 20.0
"""Of one channel of one LED at full power."""


@dataclass(frozen=True)
class Feeds:
    """Which LED of the board feeds each fiber.

    Arguments:
        leds: ``(fiber,)`` numbers from 0; None: fiber i has LED i.
        order: how the channels of an LED follow each other, like ``rgb``.
        milliamperes: of one channel at full power.
    """

    leds: tuple[int, ...] | None = None
    order: str = "rgb"
    milliamperes: float = FULL_MILLIAMPERES
