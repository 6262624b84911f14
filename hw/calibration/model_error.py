"""Which errors the model of the light may have: independent smooth modes, fitted along with it.

The model's log light is wrong by fields over the pad that are smooth in a fiber's frame: Gaussian
processes with a squared-exponential covariance (Rasmussen and Williams 2006, eq. 4.9). The
covariance is split into modes, each with an amplitude of standard deviation 1 (Karhunen-Loeve;
section 4.3 there). The fit finds these amplitudes together with the material, so what a likely
error of the model explains is not taken for another material.
"""

from __future__ import annotations

import numpy as np

from hw.calibration.reference_lines import frame_positions
from render.arrays import Array

ErrorModes = tuple[Array, ...]
"""For each bend ``(mode, fiber, point)`` log light, 0 at fibers that it is not about."""

LENGTH_SCALE = 3.0
LOG_LENGTH_SCALE = 0.5
"""Length scales of the ratio of rendered to drawn light: mm beside a fiber's axis, and the
logarithm of the distance from the edge. The most likely kernel of thirteen on renders of finger20
at three materials, better than one length scale for both by 5 to 22 in log likelihood."""
MIN_DISTANCE = 0.3
"""Distance (mm) from the edge below which nothing changes any more."""
STRETCHES = (0.4, 1.0, 3.0)
"""Length scales of errors, in those of the ratio: ripples, and what looks like absorption."""
DROPPED_VARIANCE = 1e-2
"""Fraction of the variance that modes may leave out."""


def kernel(a: Array, b: Array, stretch: float = 1.0) -> Array:
    """Return the covariance ``(n, m)`` of fields at places ``(n, 2)`` and ``(m, 2)``, variance 1.

    Places are mm in a fiber's frame; ``stretch`` multiplies the length scales.
    """
    across = (a[:, None, 0] - b[None, :, 0]) / (stretch * LENGTH_SCALE)
    logs = [np.log(np.maximum(places[:, 1], MIN_DISTANCE)) for places in (a, b)]
    outwards = (logs[0][:, None] - logs[1][None]) / (stretch * LOG_LENGTH_SCALE)
    return np.asarray(np.exp(-0.5 * (across**2 + outwards**2)))


def modes_of(covariance: Array) -> Array:
    """Return modes ``(mode, n)`` whose outer products sum to ``covariance`` ``(n, n)``."""
    variance, direction = np.linalg.eigh(covariance)
    variance = np.maximum(variance[::-1], 0.0)
    kept = (1 - DROPPED_VARIANCE) * variance.sum()
    count = int(np.searchsorted(np.cumsum(variance), kept)) + 1
    return np.asarray((np.sqrt(variance[:count]) * direction[:, ::-1][:, :count]).T)


def field_modes(size: Array, fibers: int) -> ErrorModes:
    """Return the modes of fields of relative ``size`` ``(bend,)``, half common to all fibers.

    A third each has a shorter length scale than corrections, the same, and that of the whole pad.
    """
    place = frame_positions()
    own = modes_of(np.mean([kernel(place, place, stretch) for stretch in STRETCHES], axis=0))
    count = len(own)
    whole = np.zeros((count * (fibers + 1), fibers, len(place)))
    whole[:count] = own[:, None]
    for fiber in range(fibers):
        whole[count * (fiber + 1) : count * (fiber + 2), fiber] = own
    return tuple(np.sqrt(0.5) * bend_size * whole for bend_size in size)
