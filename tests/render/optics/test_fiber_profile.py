"""The Gaussian profile of a fiber end."""

from __future__ import annotations

from types import ModuleType

import numpy as np
import pytest

from render.optics.fiber_profile import (
    angle,
    density,
    peak_radiance,
    sample_direction,
    truncated_mass,
)

WIDTHS = pytest.mark.parametrize("degrees", [0.1, 15.0, 89.0])
COUNT = 200_000


def drawn(mono: ModuleType, sigma_v: float) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(3)
    u, v = (mono.Float(rng.random(COUNT).astype(np.float32)) for _ in range(2))
    theta = angle(sample_direction(u, v, mono.Float(sigma_v), mono.Float(truncated_mass(sigma_v))))
    pdf = density(theta, mono.Float(sigma_v), mono.Float(truncated_mass(sigma_v)))
    return np.array(theta, dtype=np.float64), np.array(pdf, dtype=np.float64)


@WIDTHS
def test_the_peak_radiance_makes_a_fiber_end_of_any_area_emit_unit_power(degrees: float) -> None:
    sigma_v, area = np.radians(degrees), 0.44
    theta = np.linspace(0, min(np.pi / 2, 20 * sigma_v), 20_001)
    profile = peak_radiance(sigma_v, area) * np.exp(-((theta / (2 * sigma_v)) ** 2))
    flux = np.trapezoid(profile * np.cos(theta) * np.sin(theta), theta)
    assert 2 * np.pi * area * flux == pytest.approx(1.0, rel=1e-6)


@WIDTHS
def test_a_sampled_direction_times_radiance_over_density_gives_the_power(
    mono: ModuleType, degrees: float
) -> None:
    sigma_v, area = np.radians(degrees), 0.44
    theta, pdf = drawn(mono, sigma_v)
    radiance = peak_radiance(sigma_v, area) * np.exp(-((theta / (2 * sigma_v)) ** 2))
    power = area * radiance * np.cos(theta) / pdf
    assert abs(power.mean() - 1.0) < 4 * power.std() / np.sqrt(COUNT) + 1e-5


@WIDTHS
def test_sampled_angles_follow_the_stated_distribution(mono: ModuleType, degrees: float) -> None:
    sigma_v = np.radians(degrees)
    theta = np.sort(drawn(mono, sigma_v)[0])
    cumulative = -np.expm1(-((theta / (2 * sigma_v)) ** 2)) / truncated_mass(sigma_v)
    # Kolmogorov-Smirnov distance; 1.95 / sqrt(n) is exceeded once in a thousand times.
    distance = np.abs(cumulative - (np.arange(COUNT) + 0.5) / COUNT).max()
    assert distance < 1.95 / np.sqrt(COUNT)


def test_nothing_is_emitted_behind_the_end_face(mono: ModuleType) -> None:
    pdf = density(mono.Float([1.6, 3.1]), mono.Float(1.5), mono.Float(truncated_mass(1.5)))
    assert (np.array(pdf) == 0).all()
