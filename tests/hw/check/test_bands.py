"""Bands in photographs of an emulated rig: found where pulses make them, and nowhere else."""

from __future__ import annotations

from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray

from hw.calibration.material_table import fiber_images
from hw.calibration.reference_lines import Setup
from hw.camera.photo_set import PhotoSet
from hw.check.bands import find_bands
from hw.check.prediction import SiteSpots
from hw.cli.check import bands_sentence
from hw.emulator.emulated_camera import CameraImperfections, EmulatedCamera
from optimize.design import baseline_design
from optimize.mounting import pulse_ripple
from optimize.placement import searched_scene
from render.arrays import Array
from render.scene import Scene, load_scene

BLACK, BRIGHT = 8.0, 150.0


@cache
def images() -> NDArray[np.float32]:
    setup = Setup(load_scene("digit"), baseline_design(load_scene("digit")).phi, np.zeros(1))
    return fiber_images(setup, rays=2000, seed=3)[0]


def timed(exposure_time: float, line_time: float, part: str = "ws2812b") -> Scene:
    drawn = load_scene("digit").with_(
        camera_exposure_time=exposure_time, camera_line_time=line_time
    )
    return searched_scene(drawn, place=False, parts=[part])


def photographed(scene: Scene, lamp: int, level: int, seed: int) -> tuple[PhotoSet, Array]:
    """Return the photograph of one lamp's last LED at a level of 255, and the powers."""
    leds = scene.palette.led_count
    each = -(-leds // 3)
    levels = np.zeros((len(images()), 3 * each), dtype=np.uint8)
    levels[lamp, leds - 1] = level
    imperfections = CameraImperfections(
        seen=scene.palette.one_shot.response, leak=((0.0,) * 3,) * leds, black=BLACK
    )
    board = SimpleNamespace(levels=levels.reshape(-1, 3))
    gain = BRIGHT / images()[lamp].max() / (level / 255)
    camera = EmulatedCamera(
        scene, images(), board, gain, np.ones(len(images())), imperfections, seed  # type: ignore[arg-type]
    )  # fmt: skip
    power = levels[:, :leds] / 255.0
    return PhotoSet({lamp: camera.capture() - BLACK}, None), power


def test_strong_bands_are_found_and_steady_lamps_have_none() -> None:
    rng, found, pad = np.random.default_rng(5), [], SiteSpots(load_scene("digit"), 0.0).pad
    for number in range(24):
        # 3 to 8 bands in 320 rows.
        scene = timed(float(rng.uniform(0.5, 2.0)), 25_000 / rng.uniform(3.2, 8.0) / 10)
        lamp, level = number % 3, int(rng.integers(25, 180))
        for steady in (False, True):
            photos, power = photographed(scene, lamp, 255 if steady else level, number)
            bands = find_bands(scene, power, photos, pad)
            if steady:
                assert not bands
            elif pulse_ripple(level / 255, scene.camera.exposure_time * 0.4) > 0.6:  # type: ignore[operator]
                found.append(bool(bands))
    assert len(found) >= 12
    assert np.mean(found) >= 0.8, found


def test_bands_have_the_period_and_the_size_of_their_pulses() -> None:
    scene = timed(2.0, 50.0)
    photos, power = photographed(scene, 1, 64, 0)
    (band,) = find_bands(scene, power, photos, SiteSpots(load_scene("digit"), 0.0).pad)
    assert (band.photograph, band.part, band.hertz, band.rows) == ("fiber 1", "ws2812b", 400, 50.0)
    # 0.8 of a period of pulses that are on for a quarter of it: 0.05 to 0.25 of light.
    assert pulse_ripple(64 / 255, 0.8) == pytest.approx(1.0, abs=0.01)
    assert 0.5 < band.contrast < 1.5
    said = bands_sentence([band], 2.0)
    assert said.startswith("1 photograph with bands, as ws2812b makes them where it dims by pulses")
    assert "every 50 rows. Expose for 2.5 ms, whole periods, or light it fully." in said


def test_whole_periods_and_parts_dimmed_by_current_have_no_bands() -> None:
    pad = SiteSpots(load_scene("digit"), 0.0).pad
    for scene in (timed(2.5, 50.0), timed(2.0, 50.0, "red-0603")):
        photos, power = photographed(scene, 1, 64, 0)
        assert not find_bands(scene, power, photos, pad)
