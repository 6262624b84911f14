"""Before anything is measured: is it dark when it should be, and does red arrive as red?"""

from __future__ import annotations

import itertools

import numpy as np

from hw.camera.opencv_camera import CameraDevice
from hw.camera.photo_set import DARK_FRAMES, check_dark
from hw.errors import CaptureError
from hw.leds.fiber_lights import FiberLights
from render.arrays import Array
from render.scene import RGB

MIN_RISE_COUNTS = 3.0
"""Mean counts by which a lit color must brighten its channel."""
PURITY = 2.0
"""How many times more a color must brighten its own channel than any other."""
MIN_PREFERENCE = 2.0
"""How many times better another order must explain a design's colors than their own."""


def self_test(camera: CameraDevice, lights: FiberLights, level: float, settle: float) -> Array:
    """Return the dark frame ``(row, column, 3)`` after both tests.

    They are made with lights of power ``level`` in [0, 1], ``settle`` seconds after each was set.

    Raises:
        CaptureError: room light, no light at all, swapped channels, or mixed colors.
    """
    lights.off()
    lights.hold(settle)
    dark = camera.capture(DARK_FRAMES)
    check_dark(dark, "the dark frame")
    rise = np.empty((3, 3))
    for color in range(3):
        lights.set(np.tile(level * np.eye(3)[color], (len(lights.channels.leds), 1)))
        lights.hold(settle)
        rise[color] = (camera.capture() - dark).mean(axis=(0, 1))
    lights.off()
    check_channels(rise)
    return dark


def check_channels(rise: Array) -> None:
    """Refuse colors that arrive in the wrong channel.

    ``rise`` ``(color, channel)`` is mean counts by which each lit color brightens each channel.

    Raises:
        CaptureError: names the order in which channels arrive.
    """
    if rise.max() < MIN_RISE_COUNTS:
        raise CaptureError(
            f"the lights brighten the photograph by {rise.max():.1f} counts, allowed: at least "
            f"{MIN_RISE_COUNTS:g}; see that LEDs are on and the lens is free, or raise the "
            "exposure",
            field="capture",
        )
    best, _ = _best_order(rise)
    if best != (0, 1, 2):
        order = "".join("rgb"[best.index(c)] for c in range(3))
        raise _swapped(best, np.ones(3), f"set --order to {order}, or the camera's pixel format")
    others = rise.copy()
    np.fill_diagonal(others, 0.0)
    mixed = np.diag(rise) < PURITY * np.maximum(others, 0.0).max(axis=1)
    if mixed.any():
        color = int(np.argmax(mixed))
        raise CaptureError(
            f"{RGB.names[color]} light also brightens other channels by up to "
            f"{others[color].max() / rise[color, color]:.0%} of its own, allowed: at most "
            f"{1 / PURITY:.0%}; switch the camera's color correction off",
            field="capture",
        )


def check_order(expected: Array, seen: Array) -> None:
    """Refuse photographs of a design whose channels are in another order than red, green, blue.

    ``expected`` and ``seen`` ``(n, 3)`` are colors of fibers or of sites, predicted and
    photographed with any gain. A single fiber with swapped colors changes a small part of them;
    only an order that nearly all fibers have in common is refused.

    Raises:
        CaptureError: names the channels in which colors arrive.
    """
    used = expected.max(axis=0) > 0
    mixing = np.zeros((3, 3))
    mixing[used] = np.linalg.lstsq(expected[:, used], seen, rcond=None)[0]
    # Colors of different strength count alike; a channel may be weak, but not negative.
    mixing = np.maximum(mixing, 0.0)
    mixing /= np.maximum(mixing.sum(axis=1, keepdims=True), 1e-12)
    best, purity = _best_order(mixing)
    if purity > MIN_PREFERENCE * np.trace(mixing) and purity >= 0.8 * used.sum():
        raise _swapped(best, used, "save the photographs as RGB, or set --order as the LEDs are "
                       "wired")  # fmt: skip


def _best_order(mixing: Array) -> tuple[tuple[int, ...], float]:
    """Return the channels of the colors that most of ``mixing`` ``(color, channel)`` is in."""
    orders = list(itertools.permutations(range(3)))
    sums = [float(mixing[range(3), order].sum()) for order in orders]
    best = int(np.argmax(sums))
    return orders[best], sums[best]


def _swapped(order: tuple[int, ...], used: Array, step: str) -> CaptureError:
    said = ", ".join(f"{RGB.names[c]} in {'RGB'[order[c]]}" for c in range(3) if used[c])
    return CaptureError(
        f"colors arrive in the wrong channels ({said}), allowed: red, green, blue; {step}",
        field="order",
    )
