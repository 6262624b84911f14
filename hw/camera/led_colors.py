"""LED colors as a camera's channels see them: which are a color's own, and what miswiring does."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from render.arrays import Array
from render.scene import RGB, Palette

MAX_LEAK = 0.5
"""Light of a color in a channel, over that in the channel that sees most of it, from which on the
channel is one of the color's own; below, it is a leak."""


def own_channels(response: Array) -> NDArray[np.bool_]:
    """Return which channels are a color's own, ``(color, channel)``, for such a ``response``.

    Of red, green and blue LEDs that is one each; white ones have all.
    """
    return np.asarray(response > MAX_LEAK * response.max(axis=1, keepdims=True))


def exchanges(count: int) -> list[tuple[int, ...]]:
    """Return how so many wires may be connected wrongly: two exchanged, or all moved along.

    >>> exchanges(3)
    [(0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0)]
    """
    straight = tuple(range(count))
    found = {straight[step:] + straight[:step] for step in range(count)}
    for first in range(count):
        for second in range(first):
            order = list(straight)
            order[first], order[second] = second, first
            found.add(tuple(order))
    return sorted(found - {straight})


def channel_label(palette: Palette, channel: int) -> str:
    """Return how a channel is called in a sentence: its initial for red, green and blue."""
    name = palette.channels[channel]
    return name[0].upper() if palette.channels == RGB.channels else name
