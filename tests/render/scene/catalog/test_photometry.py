"""Light of data sheets against closed forms, integrals and sheets that state a thing twice."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import quad

from render.scene.catalog.led import Die, Led, shipped_leds
from render.scene.catalog.photometry import (
    GRID,
    band,
    cosine_exponent,
    flux,
    gaussian,
    lumens_per_watt,
    photopic,
    spectrum,
)

CIE_1924 = {450: 0.038, 480: 0.139, 510: 0.503, 530: 0.862, 555: 1.0, 590: 0.757, 620: 0.381}
"""V of the CIE, rounded."""
BROADCOM = {(622, 20): 210.0, (530, 35): 535.0, (470, 25): 84.0}
"""lm/W by dominant wavelength and width of ASMT-QTB4-0AA02, which states luminous efficacy."""


@pytest.mark.parametrize("half_angle", [10.0, 20.0, 45.0, 60.0, 75.0])
def test_flux_is_the_integral_of_the_intensity(half_angle: float) -> None:
    half = math.radians(half_angle)
    m = cosine_exponent(half)
    assert math.cos(half) ** m == pytest.approx(0.5)
    whole, _ = quad(lambda t: 2 * math.pi * math.cos(t) ** m * math.sin(t), 0.0, math.pi / 2)
    assert flux(3.0, half) == pytest.approx(3.0 * whole, rel=1e-7)


def test_a_lambertian_lamp_gives_pi_times_its_intensity() -> None:
    assert flux(1.0, math.radians(60.0)) == pytest.approx(math.pi)


@pytest.mark.parametrize(("wavelength", "seen"), CIE_1924.items())
def test_the_eye_sees_as_the_cie_says(wavelength: float, seen: float) -> None:
    assert photopic(np.array([float(wavelength)]))[0] == pytest.approx(seen, abs=0.02)


@pytest.mark.parametrize(("die", "stated"), BROADCOM.items())
def test_efficacy_is_that_of_a_sheet_that_states_it(
    die: tuple[float, float], stated: float
) -> None:
    assert lumens_per_watt(spectrum(*die)) == pytest.approx(stated, rel=0.25)


def test_monochromatic_light_of_555_nm_has_683_lumens_per_watt() -> None:
    assert lumens_per_watt(spectrum(555.0, 1.0)) == pytest.approx(683.0, rel=0.005)


def test_white_is_as_white_as_its_sheet_says() -> None:
    # Wyman, Sloan and Shirley (2013) fitted x and z too.
    def lobe(height: float, peak: float, below: float, above: float) -> np.ndarray:
        return height * np.exp(-0.5 * ((GRID - peak) / np.where(peak > GRID, below, above)) ** 2)

    light = spectrum(455.0, 20.0, phosphor=True)
    x = lobe(1.056, 599.8, 37.9, 31.0) + lobe(0.362, 442.0, 16.0, 26.7)
    x += lobe(-0.065, 501.1, 20.4, 26.2)
    z = lobe(1.217, 437.0, 11.8, 36.0) + lobe(0.681, 459.0, 26.0, 13.8)
    seen = np.array([light @ x, light @ photopic(GRID), light @ z])
    assert seen[:2] / seen.sum() == pytest.approx([0.31, 0.31], abs=0.015)


def test_the_flux_of_a_white_chip_is_near_what_its_sheet_states_beside_its_intensity() -> None:
    # APT1608RWF/A: 140 mcd, 120 deg and 520 mlm.
    led = shipped_leds()["white-0603"]
    die = led.dies[0]
    assert die.mcd == 140.0
    assert flux(die.mcd * 1e-3, math.radians(led.half_angle_deg)) == pytest.approx(0.52, rel=0.2)


def test_powers_that_say_the_same_are_the_same() -> None:
    half = math.radians(60.0)
    lumens = flux(0.1, half)
    watts = lumens / lumens_per_watt(spectrum(525.0, 35.0))
    said = [
        {"mcd": 100.0},
        {"lm": lumens},
        {"mw": 1e3 * watts},
        {"mw_per_sr": 1e3 * watts / math.pi},
    ]
    dies = [Die.model_validate({"nm": 525.0, "width_nm": 35.0, "ma": 20.0, **one}) for one in said]
    assert [die.milliwatts(half) for die in dies] == pytest.approx([1e3 * watts] * 4)


@pytest.mark.parametrize("led", shipped_leds().values(), ids=lambda led: led.name)
def test_no_shipped_part_shines_with_more_than_it_draws(led: Led) -> None:
    assert not list(led.problems(led.name))
    for die in led.dies:
        power = die.milliwatts(math.radians(led.half_angle_deg))
        assert 0.0 < power < die.ma * (die.volts or 3.3)


def test_each_channel_sees_its_own_color_best() -> None:
    chips = [shipped_leds()[f"{name}-0603"].dies[0] for name in ("red", "green", "blue")]
    seen = np.array([die.seen_by(("red", "green", "blue")) for die in chips])
    assert (seen.argmax(axis=1) == [0, 1, 2]).all()
    infrared = shipped_leds()["infrared-0603"].dies[0]
    assert infrared.seen_by(("red", "green", "blue")).max() < 1e-6
    assert infrared.seen_by(("gray", "infrared")).min() > 0.01


def test_a_band_is_that_of_its_name_or_of_its_other_name() -> None:
    assert band("sepia") is None
    mono, gray = band("mono"), band("gray")
    assert mono is not None
    assert gray is not None
    assert np.array_equal(mono, gray)
    assert gaussian(np.array([560.0, 750.0]), 560.0, 380.0).tolist() == pytest.approx([1.0, 0.5])
