"""The Gaussian radiance profile of a fiber end (thesis 3.3.1): peak, density and sampling.

``L(omega) = L_max exp(-(theta / (2 sigma_v))^2) / (2 pi sigma_v)``, theta the angle to the axis;
``L_max`` is such that the end emits the power that is asked for. The preview has the same profile
for numpy (``render.preview.diffuser.emission.FiberEnd``) and in its shader.
Directions are sampled with theta from the Rayleigh-like density ``theta exp(-theta^2 / (4
sigma_v^2))``, cut at pi/2, which leaves the smooth weight ``cos(theta) sin(theta) / theta``.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np


def peak_radiance(sigma_v: float, area: float) -> float:
    """Return the on-axis radiance in 1/(mm^2 sr) of an end of ``area`` mm^2 with unit power."""
    from scipy.integrate import quad  # a robot that checks needs none

    flux, _ = quad(
        lambda t: np.exp(-((t / (2 * sigma_v)) ** 2)) * np.cos(t) * np.sin(t),
        0.0,
        np.pi / 2,
        points=[min(2 * sigma_v, 1.5)],
        limit=200,
    )
    return float(1.0 / (2 * np.pi * area * flux))


def truncated_mass(sigma_v: float) -> float:
    """Return the part of the Rayleigh density below pi/2, to which it is normalized."""
    return float(-np.expm1(-((np.pi / 2) ** 2) / (4 * sigma_v**2)))


def falloff(theta: Any, sigma_v: Any) -> Any:
    """Return radiance relative to the peak; 0 behind the end face."""
    return dr.select(theta < dr.pi / 2, dr.exp(-dr.square(theta / (2 * sigma_v))), 0.0)


def angle(local: Any) -> Any:
    """Return the angle of a local direction to +z, without the loss that acos has near 0."""
    return dr.atan2(dr.hypot(local.x, local.y), local.z)


def sample_direction(u: Any, v: Any, sigma_v: Any, norm: Any) -> Any:
    """Return unit directions about +z; ``norm`` is ``truncated_mass(sigma_v)``."""
    theta = 2 * sigma_v * dr.sqrt(-dr.log(dr.maximum(1.0 - u * norm, 1e-38)))
    sin, cos = dr.sincos(theta)
    s, c = dr.sincos(2 * dr.pi * v)
    return mi.Vector3f(sin * c, sin * s, cos)


def density(theta: Any, sigma_v: Any, norm: Any) -> Any:
    """Return the density per solid angle of ``sample_direction``."""
    sin_over_theta = dr.select(theta > 1e-3, dr.sin(theta) / theta, 1.0)
    return falloff(theta, sigma_v) / (4 * dr.pi * dr.square(sigma_v) * norm * sin_over_theta)
