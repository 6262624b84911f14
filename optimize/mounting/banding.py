"""Bands of LEDs that dim by pulses, in the picture of a camera whose rows are exposed in turn."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from optimize.design import part_entries
from optimize.mounting.mounting import Mounting
from optimize.readers.camera_model import FULL_SCALE
from render.arrays import Array

LEAST_COUNTS = 0.5
"""Bands below this are lost in rounding."""


def pulsed_light(duty: Array, begin: Array, periods: float) -> Array:
    """Return the light of exposures to pulses, over their mean; broadcasts.

    An LED is on for the fraction ``duty`` in (0, 1] from the start of each period; exposures begin
    ``begin`` periods after one and last so many ``periods``.

    >>> pulsed_light(np.array(0.5), np.array([0.0, 0.5, 0.9]), 0.5).round(12).tolist()
    [2.0, 0.0, 1.6]
    """

    def until(time: Array) -> Array:
        whole = np.floor(time)
        return np.asarray(whole * duty + np.minimum(time - whole, duty))

    return (until(begin + periods) - until(begin)) / (periods * duty)


def pulse_ripple(duty: float, periods: float) -> float:
    """Return how much light of pulses differs between exposures, over their mean.

    An LED is on for the fraction ``duty`` of each period, and a row is exposed for so many
    ``periods``, beginning anywhere in one. Whole periods always give the same; a rest r of one
    holds between ``max(0, r + duty - 1)`` and ``min(r, duty)`` of light.

    >>> pulse_ripple(0.5, 3.0), pulse_ripple(1.0, 0.3), round(pulse_ripple(0.5, 1.5), 3)
    (0.0, 0.0, 0.667)
    """
    rest = periods - math.floor(periods)
    if math.isclose(rest, 1.0, abs_tol=1e-9):
        return 0.0
    differs = min(rest, duty) - max(0.0, rest + duty - 1.0)
    return max(differs, 0.0) / (periods * duty)


def banding_sentences(mounting: Mounting, factor: float = 1.0) -> Iterator[str]:
    """Yield what pulses of dimmed parts do to pictures, a sentence for each part and power.

    ``factor`` is how many times as long as at the scene's exposure the design is exposed.
    """
    scene, camera = mounting.scene, mounting.scene.camera
    frequency = {
        entry.led.name: entry.led.pwm_hz for entry in part_entries(scene) if entry is not None
    }
    dimmed = {
        (row.part, row.power)
        for row in mounting.fibers
        if row.part and 0.0 < row.power < 1.0 and frequency[row.part]
    }
    for part, power in sorted(dimmed):
        hertz = frequency[part] or 0.0
        if camera.exposure_time is None:
            yield (
                f"{part} dims by pulses of {hertz:g} Hz, which may show as bands: name "
                "camera.exposure_time in the scene file, and line_time of a rolling shutter."
            )
            return
        seconds = camera.exposure_time * factor / 1e3
        counts = FULL_SCALE * pulse_ripple(power, seconds * hertz)
        if counts < LEAST_COUNTS:
            continue
        bands = (camera.line_time or 0.0) * 1e-6 * camera.rows * hertz
        where = f"{bands:.3g} bands in a picture" if bands else "flicker from picture to picture"
        steady = max(round(seconds * hertz), 1) / hertz * 1e3
        yield (
            f"{part} at {power:.0%} power dims by pulses of {hertz:g} Hz: {where} of up to "
            f"{min(counts, FULL_SCALE):.0f} counts of {FULL_SCALE:.0f} at an exposure of "
            f"{seconds * 1e3:.3g} ms; none at {steady:.4g} ms or at full power."
        )
