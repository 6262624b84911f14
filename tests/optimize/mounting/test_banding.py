"""Bands of pulsed light against pulses that are drawn and exposed."""

from __future__ import annotations

import numpy as np
import pytest

from optimize.design import DARK, Design, one_led
from optimize.mounting import Mounting, banding_sentences, mount, pulse_ripple, pulsed_light
from optimize.placement import searched_scene
from render.scene import load_scene

TICKS = 2000


def exposed(duty: float, periods: float) -> np.ndarray:
    """Return the light of an exposure that begins at every tick of a period."""
    on = (np.arange(12 * TICKS) % TICKS) < round(duty * TICKS)
    light = np.concatenate([[0], np.cumsum(on)])
    first, long = np.arange(TICKS), round(periods * TICKS)
    return light[first + long] - light[first]


@pytest.mark.parametrize("duty", [0.05, 0.3, 0.5, 0.9])
@pytest.mark.parametrize("periods", [0.2, 0.5, 1.0, 1.25, 3.9, 8.0])
def test_ripple_is_that_of_pulses_that_are_exposed(duty: float, periods: float) -> None:
    light = exposed(duty, periods)
    ripple = float(np.ptp(light) / light.mean())
    assert pulse_ripple(duty, periods) == pytest.approx(ripple, abs=2e-3)


@pytest.mark.parametrize(("duty", "periods"), [(0.05, 0.2), (0.3, 1.25), (0.9, 3.9)])
def test_light_of_an_exposure_is_that_of_the_pulses_in_it(duty: float, periods: float) -> None:
    light = exposed(duty, periods)
    begin = np.arange(TICKS) / TICKS
    np.testing.assert_allclose(
        pulsed_light(np.array(duty), begin, periods), light / light.mean(), atol=0.05
    )


def dimmed(power: float, parts: list[str], **camera: float) -> Mounting:
    drawn = load_scene("digit")
    if camera:
        drawn = drawn.with_(**{f"camera_{key}": value for key, value in camera.items()})
    scene = searched_scene(drawn, place=False, parts=parts)
    colors = np.full(scene.lamp_count, DARK)
    colors[3] = len(scene.palette.names) - 1
    lit = (colors != DARK)[:, None]
    drive = one_led(colors, len(scene.palette.names)) * lit * power
    return mount(scene, Design(np.full(len(colors), np.pi / 2), drive, scene.palette), step=0.0)


def test_a_dimmed_part_has_bands_unless_it_is_exposed_for_whole_periods() -> None:
    camera = {"exposure_time": 3.0, "line_time": 30.0}
    (said,) = banding_sentences(dimmed(0.5, ["ws2812b"], **camera))
    # 1.2 periods of 400 Hz: 0.2 more or less of 0.6; 320 rows last 3.84 periods.
    assert "3.84 bands in a picture of up to 85 counts of 255 at an exposure of 3 ms" in said
    assert "none at 2.5 ms or at full power" in said
    assert not list(banding_sentences(dimmed(0.5, ["ws2812b"], **camera), 2.5 / 3.0))
    assert not list(banding_sentences(dimmed(1.0, ["ws2812b"], **camera)))
    assert not list(banding_sentences(dimmed(0.5, ["red-0603"], **camera)))


def test_a_global_shutter_flickers_and_unknown_times_are_asked_for() -> None:
    (said,) = banding_sentences(dimmed(0.5, ["ws2812b"], exposure_time=3.0))
    assert "flicker from picture to picture of up to 85 counts" in said
    (asked,) = banding_sentences(dimmed(0.5, ["ws2812b"]))
    assert "name camera.exposure_time in the scene file" in asked


def test_times_of_a_camera_change_no_light() -> None:
    scene = load_scene("digit")
    timed = scene.with_(camera_exposure_time=3.0, camera_line_time=30.0)
    assert timed.hash == scene.hash
