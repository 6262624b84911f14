"""Light of LEDs: spectra, the eye's curve, flux of a beam, and what a camera's channels see.

Wavelengths are nm, angles rad; spectra are relative power per nm on `GRID`.
"""

from __future__ import annotations

import math
from types import MappingProxyType

import numpy as np

from render.arrays import Array

GRID = np.arange(360.0, 1061.0)
"""nm, the wavelengths of a spectrum."""
LUMENS_PER_WATT = 683.0
"""Of light of 555 nm, by the definition of the candela."""
FWHM = 2.0 * math.sqrt(2.0 * math.log(2.0))
"""Full width at half maximum of a Gaussian, in standard deviations."""
PHOSPHOR_NM, PHOSPHOR_WIDTH, PHOSPHOR_POWER = 565.0, 120.0, 2.5
"""Of the yellow light of a white LED: its peak, its width, and its power over that of the blue that
is left, such that chromaticity is x = 0.31, y = 0.31, as data sheets of cool white LEDs say."""
BANDS = MappingProxyType(
    {
        "red": (600.0, 95.0),
        "green": (533.0, 100.0),
        "blue": (460.0, 90.0),
        "gray": (560.0, 380.0),
        "infrared": (870.0, 140.0),
    }
)
"""Peak and full width at half maximum of what a channel of that name sees. Red, green and blue are
Gaussians drawn by eye after the quantum efficiencies of Sony's IMX219 and OmniVision's OV5647
(K. Hufkens, khufkens.com/projects/ov5647-spectral-response), with a filter against infrared; gray
and infrared after silicon as it is typical. Each is 1 at its peak."""
ALIASES = MappingProxyType({"mono": "gray", "luminance": "gray", "ir": "infrared"})


def gaussian(wavelength: Array, peak: float, width: float) -> Array:
    """Return a Gaussian of full ``width`` at half maximum, 1 at its ``peak``."""
    return np.asarray(np.exp(-0.5 * ((wavelength - peak) * FWHM / width) ** 2))


def spectrum(peak: float, width: float, *, phosphor: bool = False) -> Array:
    """Return the spectrum of a die: its power adds up to 1.

    With a ``phosphor`` it is the blue of a white LED, of which most becomes yellow.
    """
    light = gaussian(GRID, peak, width)
    light /= light.sum()
    if phosphor:
        yellow = gaussian(GRID, PHOSPHOR_NM, PHOSPHOR_WIDTH)
        light += PHOSPHOR_POWER * yellow / yellow.sum()
    return np.asarray(light / light.sum())


def photopic(wavelength: Array) -> Array:
    """Return how bright the eye sees light of ``wavelength``, 1 at 555 nm.

    The sum of two Gaussians, each with two widths, that Wyman, Sloan and Shirley (JCGT 2, 2013)
    fitted to the color matching function of CIE 1931 which is V.

    >>> photopic(np.array([470.0, 555.0, 630.0])).round(2).tolist()
    [0.09, 1.0, 0.26]
    """

    def lobe(height: float, peak: float, below: float, above: float) -> Array:
        sigma = np.where(wavelength < peak, below, above)
        return np.asarray(height * np.exp(-0.5 * ((wavelength - peak) / sigma) ** 2))

    return lobe(0.821, 568.8, 46.9, 40.5) + lobe(0.286, 530.9, 16.3, 31.1)


def lumens_per_watt(light: Array) -> float:
    """Return the luminous efficacy of radiation of a spectrum."""
    return LUMENS_PER_WATT * float(light @ photopic(GRID))


def cosine_exponent(half_angle: float) -> float:
    """Return m of the beam ``cos(theta)^m`` that falls to a half at ``half_angle``.

    >>> round(cosine_exponent(math.radians(60.0)), 9)
    1.0
    """
    return -math.log(2.0) / math.log(math.cos(half_angle))


def flux(intensity: float, half_angle: float) -> float:
    """Return the flux of a beam ``intensity cos(theta)^m``: ``2 pi intensity / (m + 1)``."""
    return 2.0 * math.pi * intensity / (cosine_exponent(half_angle) + 1.0)


def band(channel: str) -> Array | None:
    """Return what a camera's channel sees by wavelength; None where its name says nothing."""
    known = BANDS.get(ALIASES.get(channel, channel))
    return None if known is None else gaussian(GRID, *known)
