"""Before anything is measured: is it dark when it should be, and does red arrive as red?"""

from __future__ import annotations

import itertools

import numpy as np

from hw.camera.opencv_camera import CameraDevice
from hw.camera.photo import DARK_FRAMES
from hw.camera.photo_set import check_dark
from hw.errors import CaptureError
from hw.leds.fiber_lights import FiberLights
from render.arrays import Array

MIN_RISE_COUNTS = 3.0
"""Mean counts by which a lit color must brighten its channel."""
PURITY = 2.0
"""How many times more a color must brighten its own channel than any other."""


def self_test(camera: CameraDevice, lights: FiberLights, level: float, settle: float) -> Array:
    """Return the dark frame ``(row, column, 3)`` after both tests.

    Arguments:
        camera: of the rig.
        lights: of the rig.
        level: power of the lights, in [0, 1].
        settle: seconds to wait after a light was set.

    Raises:
        CaptureError: room light, no light at all, swapped channels, or mixed colors.
    """
    lights.off()
    lights.hold(settle)
    dark = camera.capture(DARK_FRAMES)
    check_dark(dark, "the dark frame")
    rise = np.empty((3, 3))
    fibers = len(lights.channels.leds)
    for color in range(3):
        power = np.zeros((fibers, 3))
        power[:, color] = level
        lights.set(power)
        lights.hold(settle)
        rise[color] = (camera.capture() - dark).mean(axis=(0, 1))
    lights.off()
    check_channels(rise)
    return dark


def check_channels(rise: Array) -> None:
    """Refuse colors that arrive in the wrong channel.

    Arguments:
        rise: ``(color, channel)`` mean counts by which each lit color brightens each channel.

    Raises:
        CaptureError: names the order in which channels arrive.
    """
    if rise.max() < MIN_RISE_COUNTS:
        raise CaptureError(
            f"the lights brighten the photograph by {rise.max():.1f} counts, allowed: at least "
            f"{MIN_RISE_COUNTS:g}; see that LEDs are on and the lens is free, or raise the "
            "exposure",
            field="capture",
            value=float(rise.max()),
        )
    best = max(itertools.permutations(range(3)), key=lambda p: sum(rise[c, p[c]] for c in range(3)))
    if best != (0, 1, 2):
        said = ", ".join(f"{['red', 'green', 'blue'][c]} in {'RGB'[best[c]]}" for c in range(3))
        raise CaptureError(
            f"colors arrive in the wrong channels ({said}): set --order to "
            f"{''.join('rgb'[best.index(c)] for c in range(3))}, or the camera's pixel format",
            field="order",
            value=best,
        )
    others = rise.copy()
    np.fill_diagonal(others, 0.0)
    mixed = np.diag(rise) < PURITY * np.maximum(others, 0.0).max(axis=1)
    if mixed.any():
        color = int(np.argmax(mixed))
        raise CaptureError(
            f"{['red', 'green', 'blue'][color]} light also brightens other channels by up to "
            f"{others[color].max() / rise[color, color]:.0%} of its own, allowed: at most "
            f"{1 / PURITY:.0%}; switch the camera's color correction off",
            field="capture",
        )
