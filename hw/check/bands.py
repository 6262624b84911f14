"""Bands that LEDs which dim by pulses leave in photographs of a rolling shutter.

Rows are exposed one after the other, so pulses of a known frequency f and a line time t multiply
the light by a pattern of 1 / (f t) rows, the same in every column. Of the logarithm of the light
polynomials along the columns are taken out; what is left must be a wave of that period rather than
of another, in step across the picture.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hw.camera.photo_set import PhotoSet
from hw.check.prediction import shining
from optimize.design import part_entries
from optimize.mounting import pulse_rates
from render.arrays import Array
from render.scene import Scene

BLOCKS = 8
"""Groups of columns that are looked at alone."""
LEAST_WAVES = 1.5
"""Bands in a picture below which they look like light that falls off."""
LEAST_ROWS = 3.0
"""Rows of a band: finer ones are not seen as such."""
LEAST_CONTRAST = 0.02
"""Largest less least light, over its mean: bands below it change no color by more than 1 %."""
OTHERS = (0.6, 1.5)
"""Frequencies, over that of the pulses, whose waves must explain the picture worse."""
LEAST_LEAD, LEAST_SIGNIFICANCE = 1.3, 8.0
"""How many times the squares that another frequency explains, and the wave of all columns over the
standard error of its groups: of 178 steady lamps of `digit`, `digit-dome` and `gelsight-flat` none
reached both (largest significance 7.2); ``tests/hw/check/test_bands.py`` counts finds."""
DIM = 0.2
"""Light of a group of columns, over that of all, below which it is left out."""
LEAST_COUNTS = 1.0
"""Light of a row below which it says nothing."""


@dataclass(frozen=True)
class Bands:
    """Bands in a photograph.

    Arguments:
        photograph: "fiber 3", or "all fibers".
        part: name of the LED that dims by pulses of ``hertz``.
        contrast: largest less least light, over its mean.
        rows: from one band to the next.
    """

    photograph: str
    part: str
    hertz: float
    contrast: float
    rows: float


def find_bands(
    scene: Scene, power: Array, photos: PhotoSet, seen: NDArray[np.bool_]
) -> list[Bands]:
    """Return the bands in the photographs of a rig, one for each photograph and frequency.

    ``power`` ``(fiber, LED)`` is the design's, ``seen`` ``(row, column)`` where the pad is. Without
    a line time nothing is known of bands.
    """
    found: list[Bands] = []
    if not scene.camera.line_time:
        return found
    for name, photo, lit in _photographs(power, photos):
        for part, hertz in _pulsed_parts(scene, lit).items():
            rows = 1e6 / (hertz * scene.camera.line_time)
            contrast = band_contrast(photo, seen, rows)
            if contrast >= LEAST_CONTRAST:
                found.append(Bands(name, part, hertz, contrast, rows))
    return found


def _photographs(power: Array, photos: PhotoSet) -> Iterator[tuple[str, Array, NDArray[np.bool_]]]:
    """Yield name, light ``(row, column, channel)``, lit LEDs ``(fiber, LED)`` of photographs."""
    lit = np.asarray(shining(power))
    for fiber, photo in photos.alone.items():
        yield f"fiber {fiber}", photo, lit[fiber : fiber + 1]
    if photos.together is not None:
        yield "all fibers", photos.together, lit


def _pulsed_parts(scene: Scene, lit: NDArray[np.bool_]) -> dict[str, float]:
    """Return the frequencies (Hz) of parts among LEDs ``lit`` ``(fiber, LED)`` with pulses."""
    rates = pulse_rates(scene)
    shots = scene.palette.in_shots(lit.astype(np.float64))
    pulsed = set(np.flatnonzero(shots.sum(axis=(0, 1)) * rates).tolist())
    return {
        entry.led.name: rates[led]
        for led, entry in enumerate(part_entries(scene))
        if entry is not None and led in pulsed
    }


def band_contrast(photo: Array, seen: NDArray[np.bool_], rows: float) -> float:
    """Return the contrast of bands that come every so many ``rows``; 0 where there are none.

    ``photo`` ``(row, column, channel)`` is linear light in counts, ``seen`` ``(row, column)`` where
    it shows the pad.
    """
    shown = np.flatnonzero(seen.any(axis=1))
    waves = len(shown) / rows
    if rows < LEAST_ROWS or waves < LEAST_WAVES:
        return 0.0
    profiles = _profiles(photo, seen)
    profiles = profiles[profiles.mean(axis=1) > DIM * profiles.mean()]
    # Where pulses leave rows dark, their logarithm ends at the light that says nothing.
    light = np.log(np.maximum(profiles[:, shown], LEAST_COUNTS))
    turns = (shown - shown[0]) / rows
    place = np.linspace(-1.0, 1.0, len(shown))
    # Polynomials of a degree that is 1.5 times the number of waves bend less often than these.
    slow: Array = np.linalg.qr(np.polynomial.legendre.legvander(place, int(1.5 * waves)))[0]
    light = light - light @ slow @ slow.T
    own, *others = (_Wave.in_light(light, turns * factor, slow) for factor in (1.0, *OTHERS))
    leads = own.explained >= LEAST_LEAD * max(other.explained for other in others)
    return 2.0 * own.amplitude if leads and own.significance >= LEAST_SIGNIFICANCE else 0.0


def _profiles(photo: Array, seen: NDArray[np.bool_]) -> Array:
    """Return the mean light of rows in each group of columns, ``(block, row)``; 0 where unseen."""
    light = np.where(seen, photo.sum(axis=2), 0.0)
    columns = np.array_split(np.flatnonzero(seen.any(axis=0)), BLOCKS)
    return np.stack(
        [
            light[:, own].sum(axis=1) / np.maximum(seen[:, own].sum(axis=1), 1)
            for own in columns
            if len(own)
        ]
    )


@dataclass(frozen=True)
class _Wave:
    """A wave along the rows, the same in all columns.

    ``explained`` is its part of the squares of the light, ``significance`` its amplitude over the
    standard error of what groups of columns say of it.
    """

    explained: float
    amplitude: float
    significance: float

    @classmethod
    def in_light(cls, light: Array, turns: Array, slow: Array) -> _Wave:
        """Return the wave of such ``turns`` ``(row,)`` in ``light`` ``(block, row)``.

        Both are without the ``slow`` polynomials ``(row, degree)``.
        """
        wave = np.stack([np.cos(2 * np.pi * turns), np.sin(2 * np.pi * turns)])
        wave = wave - wave @ slow @ slow.T
        of_blocks, *_ = np.linalg.lstsq(wave.T, light.T, rcond=None)
        strength = of_blocks.mean(axis=1)
        error = np.sqrt(of_blocks.var(axis=1).sum() / light.shape[0])
        amplitude, squares = float(np.hypot(*strength)), np.square(light).sum()
        explained = 1.0 - np.square(light - strength @ wave).sum() / squares if squares else 0.0
        return cls(float(explained), amplitude, amplitude / error if error else 0.0)
