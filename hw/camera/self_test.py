"""Before anything is measured: is it dark when it should be, and does red arrive as red?"""

from __future__ import annotations

import numpy as np

from hw.camera.led_colors import MAX_LEAK, channel_label, exchanges, own_channels
from hw.camera.opencv_camera import CameraDevice
from hw.camera.photo_set import DARK_FRAMES, check_dark
from hw.errors import CaptureError
from hw.leds.fiber_lights import FiberLights
from render.arrays import Array
from render.scene import RGB, Palette

MIN_RISE_COUNTS = 3.0
"""Mean counts by which a lit color must brighten the channel that sees most of it."""
MIN_PREFERENCE = 2.0
"""How many times better another order must explain a design's colors than their own."""
MIN_MORE_LIKE = 0.1
"""By how much another order must explain the colors better, of 1 for every channel."""
MIN_SINGULAR = 0.02
"""Colors of a design that differ by less than this part of their light are not told apart."""


def self_test(
    camera: CameraDevice,
    lights: FiberLights,
    level: float,
    settle: float,
    palette: Palette = RGB,
) -> Array:
    """Return the dark frame ``(row, column, channel)`` after both tests.

    They are made with lights of power ``level`` in [0, 1], ``settle`` seconds after each was set;
    ``palette`` says which channel sees which LED.

    Raises:
        CaptureError: room light, no light at all, swapped channels or LEDs, or mixed colors.
    """
    lights.off()
    lights.hold(settle)
    dark = camera.capture(DARK_FRAMES)
    check_dark(dark, "the dark frame")
    rise = np.empty(palette.matrix.shape)
    for color, only in enumerate(np.eye(len(palette.names))):
        lights.set(np.tile(level * only, (len(lights.channels.leds), 1)))
        lights.hold(settle)
        rise[color] = (camera.capture() - dark).mean(axis=(0, 1))
    lights.off()
    check_channels(rise, palette)
    return dark


def check_channels(rise: Array, palette: Palette = RGB) -> None:
    """Refuse colors that arrive in the wrong channel.

    ``rise`` ``(color, channel)`` is mean counts by which each lit color brightens each channel.

    Raises:
        CaptureError: names the order in which channels arrive, or LEDs shine.
    """
    if rise.max() < MIN_RISE_COUNTS:
        raise CaptureError(
            f"the lights brighten the photograph by {rise.max():.1f} counts, allowed: at least "
            f"{MIN_RISE_COUNTS:g}; see that LEDs are on and the lens is free, or raise the "
            "exposure",
            field="capture",
        )
    _check_order_of_rise(rise, palette)
    response = palette.matrix
    own = own_channels(response)
    most = np.where(own, rise, 0.0).max(axis=1, keepdims=True)
    # A channel that is said to see a part of a color, at its gain, may see twice as much.
    owned = np.where(own, response, 0.0).sum(axis=0)
    gain = np.where(own, rise, 0.0).sum(axis=0) / np.where(owned > 0, owned, np.inf)
    said = response * gain
    brightest = np.where(own, said, 0.0).max(axis=1, keepdims=True)
    allowed = np.maximum(MAX_LEAK, 2 * said / np.maximum(brightest, 1e-12))
    excess = np.where(own, 0.0, np.maximum(rise, 0.0) - allowed * most)
    mixed = (excess > 0).any(axis=1)
    if mixed.any():
        color = int(np.argmax(mixed))
        channel = int(np.argmax(excess[color]))
        raise CaptureError(
            f"{palette.names[color]} light also brightens other channels by up to "
            f"{rise[color, channel] / most[color, 0]:.0%} of its own, allowed: at most "
            f"{allowed[color, channel]:.0%}; switch the camera's color correction off",
            field="capture",
        )


def _check_order_of_rise(rise: Array, palette: Palette) -> None:
    """Refuse ``rise`` that another order of channels, or of LEDs, explains better."""
    response, seen = palette.matrix, np.maximum(rise, 0.0)
    straight = _likeness(seen, response)
    colors, channels = response.shape
    by_channel = [(_likeness(seen, response[:, order]), order) for order in exchanges(channels)]
    by_led = [(_likeness(seen, response[list(order)]), order) for order in exchanges(colors)]
    # Where every color has a channel of its own, channels tell both.
    best, order = max([*by_channel, *([] if palette.exchangeable else by_led)],
                      key=lambda found: found[0], default=(0.0, ()))  # fmt: skip
    if best <= straight + MIN_MORE_LIKE:
        return
    if (best, order) in by_channel:
        # Channel c sees what is another's: where each one's light arrives.
        arrives = tuple(order.index(c) for c in range(channels))
        step = "set the camera's pixel format"
        if palette.exchangeable and channels == 3:
            letters = "".join("rgb"[arrives.index(c)] for c in range(3))
            step = f"set --order to {letters}, or the camera's pixel format"
        raise _swapped(palette, arrives, np.ones(channels), step)
    names = palette.names
    said = ", ".join(
        f"{names[color]} as {names[other]}" for color, other in enumerate(order) if color != other
    )
    raise CaptureError(
        f"LEDs are seen as others ({said}), allowed: each as its response in the scene says; "
        "correct their wiring or --order, or the scene's colors",
        field="order",
    )


def _likeness(seen: Array, expected: Array) -> float:
    """Return the cosines between channels ``(color, channel)``, summed: no gain changes them."""
    norms = np.linalg.norm(seen, axis=0) * np.linalg.norm(expected, axis=0)
    return float(((seen * expected).sum(axis=0) / np.maximum(norms, 1e-12)).sum())


def check_order(expected: Array, seen: Array, palette: Palette = RGB) -> None:
    """Refuse photographs of a design whose channels are in another order than the scene's.

    ``expected`` and ``seen`` ``(n, channel)`` are colors of fibers or of sites, predicted and
    photographed with any gain. A single fiber with swapped colors changes a small part of them;
    only an order that nearly all fibers have in common is refused.

    Raises:
        CaptureError: names the channels in which colors arrive.
    """
    channels = expected.shape[1]
    used = expected.max(axis=0) > 0
    mixing = np.zeros((channels, channels))
    # Where several LEDs look alike, fewer colors than channels are told apart.
    rank = np.linalg.matrix_rank(palette.matrix, rtol=MIN_SINGULAR)
    cut = None if rank == channels else MIN_SINGULAR
    mixing[used] = np.linalg.lstsq(expected[:, used], seen, rcond=cut)[0]
    # Colors of different strength count alike; a channel may be weak, but not negative.
    mixing = np.maximum(mixing, 0.0)
    mixing /= np.maximum(mixing.sum(axis=1, keepdims=True), 1e-12)
    best, purity = _best_order(mixing)
    if purity > MIN_PREFERENCE * np.trace(mixing) and purity >= 0.8 * used.sum():
        step = "set --order as the LEDs are wired" if palette.exchangeable else (
            "set the camera's pixel format")  # fmt: skip
        kind = "RGB" if palette.channels == RGB.channels else ", ".join(palette.channels)
        raise _swapped(palette, best, used, f"save the photographs as {kind}, or {step}")


def _best_order(mixing: Array) -> tuple[tuple[int, ...], float]:
    """Return the channels that most of ``mixing`` ``(channel, channel)`` is in, and how much."""
    count = len(mixing)
    orders = [tuple(range(count)), *exchanges(count)]
    sums = [float(mixing[range(count), order].sum()) for order in orders]
    best = int(np.argmax(sums))
    return orders[best], sums[best]


def _swapped(palette: Palette, order: tuple[int, ...], used: Array, step: str) -> CaptureError:
    names = palette.channels
    said = ", ".join(
        f"{names[c]} in {channel_label(palette, order[c])}" for c in range(len(names)) if used[c]
    )
    return CaptureError(
        f"colors arrive in the wrong channels ({said}), allowed: {', '.join(names)}; {step}",
        field="order",
    )
