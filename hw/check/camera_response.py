"""What a camera's channels see of a rig: their gains, and their response to each LED color.

Both come from sweeps of single fibers, by medians, so that faulty ones do not move them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hw.camera.led_colors import MAX_LEAK, own_channels
from hw.check.prediction import PadPrediction
from hw.errors import CaptureError
from render.arrays import Array

ENOUGH_FIBERS = 3
"""Fibers in a channel from which on one that is faulty does not move their median."""
MAX_MISMATCH = 2.0
"""Factor within which a color is seen as the scene says: beyond, it is another color."""
MIN_GAIN = 0.1
"""Gain over the largest one from which it is that of a camera, not of dead fibers."""
MEDIAN_ROUNDS = 20
"""Of Tukey's median polish (1977), which converges in a few."""


def measured_response(prediction: PadPrediction, colors: Array, *, recorded: bool = False) -> Array:
    """Return what each channel sees of each LED color, ``(color, channel)``.

    The median over fibers of one color, so that a faulty one does not move it; where they are fewer
    than `ENOUGH_FIBERS`, all must agree that it is no wrong color. ``colors`` ``(fiber, site,
    channel)`` are counts of each fiber alone. Colors that no fiber has alone keep the response of
    ``prediction``. It is relative to the gains of `channel_gains`, so where it is ``recorded`` to
    those of a record; in the channel that sees most of a color it is what it was, but where that
    sees another color as its own too: gains do not tell these apart.
    """
    response, power = prediction.response.copy(), prediction.power
    gain = channel_gains(prediction.alone, colors, prediction.own, recorded, prediction.one_led)
    seen = (colors / gain).sum(axis=1) / prediction.tint
    expected = prediction.alone.sum(axis=1) / prediction.tint
    strongest, own = power.argmax(axis=1), own_channels(response)
    for color, channel in enumerate(response.argmax(axis=1)):
        alone = (strongest == color) & (power[:, color] > 0.95 * power.sum(axis=1))
        bright = alone & (seen[:, channel] > 0.1 * seen[alone, channel].max(initial=0.0))
        if not bright.any() or bright.sum() < min(ENOUGH_FIBERS, alone.sum()):
            continue
        ratio = seen[bright] / seen[bright, channel, None]
        median, enough = np.median(ratio, axis=0), bright.sum() >= ENOUGH_FIBERS
        least, most = (median, median) if enough else (ratio.min(axis=0), ratio.max(axis=0))
        said = prediction.response[color] / prediction.response[color, channel]
        if (most >= np.maximum(MAX_LEAK, MAX_MISMATCH * said)).any() or (
            own[color] & (least <= said / MAX_MISMATCH)
        ).any():
            continue
        strength = 1.0
        if enough and own[:, channel].sum() > 1:
            found = float(np.median(seen[bright, channel] / expected[bright, channel]))
            strength = found if 1 / MAX_MISMATCH < found < MAX_MISMATCH else 1.0
        response[color] = prediction.response[color, channel] * strength * np.maximum(median, 0.0)
    return response


def unmeasured_colors(prediction: PadPrediction) -> NDArray[np.bool_]:
    """Return the colors ``(color,)`` that are seen as the scene says, as no fiber has them alone.

    Those with a channel to themselves are not among them: its gain makes up for that.
    """
    own, power = own_channels(prediction.response), prediction.power
    shared = (own.sum(axis=1) > 1) | (own & (own.sum(axis=0) > 1)).any(axis=1)
    alone = power > 0.95 * np.maximum(power.sum(axis=1, keepdims=True), 1e-9)
    return np.asarray(shared & ~alone.any(axis=0))


def channel_gains(
    expected: Array,
    colors: Array,
    own: NDArray[np.bool_],
    recorded: bool = False,
    one_led: NDArray[np.bool_] | None = None,
) -> Array:
    """Return captured over expected light per channel ``(channel,)``: medians over fibers.

    Single faulty fibers do not move a median. A channel that no fiber uses gets the mean of the
    others. So does, where the healthy rig was ``recorded`` through the same camera, a channel of so
    few fibers that a dim one would pass for its gain: it has the median of the channels of enough
    fibers, or where there are none that of all fibers. What it is beside these is in the record,
    and cancels: both sides scale alike.

    Channels that see the same LED of fibers that have ``one_led`` ``(fiber,)`` are compared through
    these: their powers, which drift, are in all of these channels alike.

    Both are ``(fiber, site, channel)``; only fibers whose ``own`` ``(fiber, channel)`` LED a
    channel sees count in it.

    Raises:
        CaptureError: no light in any channel.
    """
    wanted, got = expected.sum(axis=1), colors.sum(axis=1)
    gains, few = np.full(len(own.T), np.nan), []
    bright = own & (wanted > 0.05 * wanted.max(axis=0))
    for channel in range(len(gains)):
        used = bright[:, channel]
        if used.any():
            gains[channel] = np.median(got[used, channel] / wanted[used, channel])
            if used.sum() < ENOUGH_FIBERS:
                few.append(channel)
    if one_led is not None:
        for group in _groups(bright & one_led[:, None]):
            rows = bright[:, group].any(axis=1) & one_led
            if recorded and (bright[:, group] & one_led[:, None]).sum(axis=0).min() < ENOUGH_FIBERS:
                few += [channel for channel in group if channel not in few]
            else:
                gains[group] = _compared_gains(
                    got[np.ix_(rows, group)],
                    wanted[np.ix_(rows, group)],
                    bright[np.ix_(rows, group)],
                )
    if recorded and few:
        enough = np.delete(gains, few)
        enough = enough[enough > MIN_GAIN * np.fmax.reduce(enough, initial=0.0)]
        gains[few] = np.median(enough if len(enough) else got[bright] / wanted[bright])
    found = gains[np.isfinite(gains) & (gains > 0)]
    if not len(found):
        raise CaptureError(
            "the sweep is dark: switch the LEDs on, take the lens cap off, or raise the exposure",
            field="colors",
        )
    # A channel of which most fibers are dead must not divide by nothing.
    return np.where(np.isfinite(gains) & (gains > MIN_GAIN * found.max()), gains, found.mean())


def _groups(seen: NDArray[np.bool_]) -> list[list[int]]:
    """Return the channels that ``seen`` ``(fiber, channel)`` connects, by groups of several."""
    count, lit = len(seen.T), seen.astype(np.int64)
    # Of booleans, powers say what is reached in so many steps.
    step: NDArray[np.bool_] = (lit.T @ lit > 0) | np.eye(count, dtype=np.bool_)
    reached = np.linalg.matrix_power(step, count)
    groups = {tuple(np.nonzero(row)[0].tolist()) for row in reached}
    return sorted(list(group) for group in groups if len(group) > 1)


def _compared_gains(got: Array, wanted: Array, seen: NDArray[np.bool_]) -> Array:
    """Return gains ``(channel,)`` of light that is gain times power, of fibers unknown.

    Light ``(fiber, channel)`` counts where a channel has ``seen`` it.
    """
    floor = 1e-3 * np.median(got[seen] / wanted[seen])
    with np.errstate(divide="ignore", invalid="ignore"):
        logs = np.where(seen, np.log(np.maximum(got / wanted, max(floor, 1e-12))), np.nan)
    gains, powers = np.zeros(logs.shape[1]), np.zeros(len(logs))
    for _ in range(MEDIAN_ROUNDS):
        powers = np.nanmedian(logs - gains, axis=1)
        gains = np.nanmedian(logs - powers[:, None], axis=0)
    return np.asarray(np.exp(gains + np.median(powers)))
