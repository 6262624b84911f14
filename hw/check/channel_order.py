"""Do all colors arrive in the wrong channels? Then no fiber is to blame, but the photographs."""

from __future__ import annotations

import itertools

import numpy as np

from hw.errors import CaptureError
from render.arrays import Array

MIN_PREFERENCE = 2.0
"""How many times better another order must explain the colors than their own."""
NAMES = ("red", "green", "blue")


def check_order(expected: Array, seen: Array) -> None:
    """Refuse photographs whose channels are in another order than red, green, blue.

    A single fiber with swapped colors changes a small part of what is compared; only an order
    that nearly all fibers have in common is refused.

    Arguments:
        expected: ``(n, 3)`` predicted colors, of fibers or of sites.
        seen: ``(n, 3)`` photographed colors, any gain.

    Raises:
        CaptureError: names the channels in which colors arrive.
    """
    used = expected.max(axis=0) > 0
    mixing = np.zeros((3, 3))
    mixing[used] = np.linalg.lstsq(expected[:, used], seen, rcond=None)[0]
    # Colors of different strength count alike; a channel may be weak, but not negative.
    mixing = np.maximum(mixing, 0.0)
    mixing /= np.maximum(mixing.sum(axis=1, keepdims=True), 1e-12)
    purity = {p: sum(mixing[c, p[c]] for c in range(3)) for p in itertools.permutations(range(3))}
    best = max(purity, key=lambda p: purity[p])
    if purity[best] <= MIN_PREFERENCE * purity[0, 1, 2] or purity[best] < 0.8 * used.sum():
        return
    said = ", ".join(f"{NAMES[c]} in {'RGB'[best[c]]}" for c in range(3) if used[c])
    raise CaptureError(
        f"colors arrive in the wrong channels ({said}), allowed: red, green, blue; save the "
        "photographs as RGB, or set --order as the LEDs are wired",
        field="order",
        value=best,
    )
