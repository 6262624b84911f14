"""Which errors the model of the light may have: independent smooth modes, fitted along with it.

The model's log light is wrong by fields over the pad that are smooth in a fiber's frame. Their
covariance is split into modes, each with an amplitude of standard deviation 1 (Karhunen-Loeve;
Rasmussen and Williams 2006, section 4.3). The fit finds these amplitudes together with the
material, so what a likely error of the model explains is not taken for another material.
"""

from __future__ import annotations

import numpy as np

from hw.calibration.reference_lines import frame_positions
from hw.calibration.smooth_ratio import kernel
from render.arrays import Array

ErrorModes = tuple[Array, ...]
"""For each bend ``(mode, fiber, point)`` log light, 0 at fibers that it is not about."""

LENGTH_SCALES = (0.4, 1.0, 3.0)
"""Reaches of errors, in units of what corrections know: ripples, and what looks like absorption."""
DROPPED_VARIANCE = 1e-2
"""Part of the variance that modes may leave out."""


def modes_of(covariance: Array) -> Array:
    """Return modes ``(mode, n)`` whose outer products sum to ``covariance`` ``(n, n)``."""
    size, direction = np.linalg.eigh(covariance)
    size = np.maximum(size[::-1], 0.0)
    count = int(np.searchsorted(np.cumsum(size), (1 - DROPPED_VARIANCE) * size.sum())) + 1
    return np.asarray((np.sqrt(size[:count]) * direction[:, ::-1][:, :count]).T)


def joined(one: ErrorModes, other: ErrorModes) -> ErrorModes:
    """Return the modes of two independent errors."""
    return tuple(np.concatenate(pair) for pair in zip(one, other, strict=True))


def field_modes(size: Array, fibers: int) -> ErrorModes:
    """Return the modes of fields of relative ``size`` ``(bend,)``, half common to all fibers.

    A third each reaches less far than corrections do, as far, and over the whole pad.
    """
    place = frame_positions()
    reaches = [kernel(place, place, stretch) for stretch in LENGTH_SCALES]
    own = modes_of(np.mean(reaches, axis=0))
    count = len(own)
    whole = np.zeros((count * (fibers + 1), fibers, len(place)))
    whole[:count] = own[:, None]
    for fiber in range(fibers):
        whole[count * (fiber + 1) : count * (fiber + 2), fiber] = own
    return tuple(np.sqrt(0.5) * one * whole for one in size)
