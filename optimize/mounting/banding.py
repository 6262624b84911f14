"""Bands of LEDs that dim by pulses, in the picture of a camera whose rows are exposed in turn."""

from __future__ import annotations

from collections.abc import Iterator

from optimize.design import part_entries
from optimize.mounting.mounting import Mounting
from optimize.mounting.pulses import pulse_ripple, whole_periods
from optimize.readers.camera_model import FULL_SCALE

LEAST_COUNTS = 0.5
"""Bands below this are lost in rounding."""


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
        steady = whole_periods(seconds * 1e3, hertz)
        yield (
            f"{part} at {power:.0%} power dims by pulses of {hertz:g} Hz: {where} of up to "
            f"{min(counts, FULL_SCALE):.0f} counts of {FULL_SCALE:.0f} at an exposure of "
            f"{seconds * 1e3:.3g} ms; none at {steady:.4g} ms or at full power."
        )
