"""Light of LEDs that dim by pulses, as exposures of a camera meet it."""

from __future__ import annotations

import math

import numpy as np

from optimize.design import part_entries
from render.arrays import Array
from render.scene import Scene


def pulse_rates(scene: Scene) -> Array:
    """Return the frequency (Hz) at which every LED of a scene dims, ``(LED,)``; 0: by current."""
    entries = part_entries(scene)
    return np.array([0.0 if one is None else one.led.pwm_hz or 0.0 for one in entries])


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


def whole_periods(exposure: float, hertz: float) -> float:
    """Return the exposure (ms) of whole periods of pulses that is next to a given one.

    >>> whole_periods(3.0, 400.0), whole_periods(0.1, 400.0)
    (2.5, 2.5)
    """
    return max(round(1e-3 * exposure * hertz), 1) / hertz * 1e3
