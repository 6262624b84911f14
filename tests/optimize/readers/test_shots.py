"""Shots at equal total exposure: what is the same in all of them reads as one picture does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from optimize.readers import CameraModel, PlaceError, SensorError, reading
from render.scene import Scene, load_scene
from tests.optimize.readers.test_reading import lambertian

DIM = CameraModel(read_noise=0.0, full_well=2000.0, bits=16, longest_exposure=0.05)
"""Too short for any design to saturate: what counts is how long all shots together last."""


def twice(colors: np.ndarray, shots: int) -> np.ndarray:
    return np.concatenate([colors] * shots, axis=-1)


@pytest.mark.parametrize("shots", [2, 3])
def test_together_they_last_no_longer_than_one_picture_may(shots: int) -> None:
    camera = CameraModel(longest_exposure=2.0, shots=shots)
    factor, gain, _ = camera.exposed(np.full((1, 9), 10.0))
    assert shots * factor[0] / gain[0] == pytest.approx(2.0)
    assert CameraModel.of(load_scene("digit").with_(camera_shots=shots)).shots == shots
    assert (
        f"{shots} shots that together last as long as one picture, up to 2 times" in camera.sentence
    )


@pytest.mark.parametrize("read_noise", [0.0, 3.0])
@pytest.mark.parametrize("shots", [1, 2, 3])
def test_pictures_of_shots_are_those_of_photons_counted_in_parts_of_the_time(
    shots: int, read_noise: float
) -> None:
    camera = CameraModel(
        read_noise=read_noise, full_well=500.0, bits=16, longest_exposure=1.0, shots=shots
    )
    light, draws, rng = 120.0, 200_000, np.random.default_rng(1)
    # 255 counts decide the exposure: one picture has the gain 1, n shots have the gain n.
    factor, gain, _ = camera.exposed(np.array([[255.0, light]]))
    counts = np.full((draws, shots), factor[0] * light)
    recorded = camera.recorded(counts, rng, gain[0]).mean(axis=1)
    electrons = rng.poisson(light * 500.0 / 255.0 / shots, (draws, shots))
    read = rng.normal(0.0, read_noise, (draws, shots))
    counted = (electrons * 255.0 / 500.0 + read).sum(axis=1)
    for seen in (recorded, counted):
        assert seen.mean() == pytest.approx(light, rel=2e-3)
        assert seen.var() == pytest.approx(shots * read_noise**2 + light * 255.0 / 500.0, rel=0.02)


@pytest.mark.parametrize("kind", [SensorError, PlaceError])
def test_the_same_light_in_all_shots_reads_as_one_picture_of_equal_exposure(
    kind: type, finger20: Scene
) -> None:
    colors = lambertian(finger20, 0.6)[None]
    (alone,) = kind(finger20, DIM).degrees(colors)
    for shots in (2, 3):
        (found,) = kind(finger20, replace(DIM, shots=shots)).degrees(twice(colors, shots))
        assert found == pytest.approx(alone, rel=2e-3)
        # Each is read out by itself.
        noisy = replace(DIM, read_noise=1.0)
        (more,) = kind(finger20, replace(noisy, shots=shots)).degrees(twice(colors, shots))
        assert more > 1.02 * kind(finger20, noisy).degrees(colors)[0]
        # So it is where one picture would saturate before the time is over.
        long = replace(DIM, longest_exposure=100.0)
        (bright,) = kind(finger20, long).degrees(colors)
        (parts,) = kind(finger20, replace(long, shots=shots)).degrees(twice(colors, shots))
        assert parts == pytest.approx(bright, rel=2e-3)
        assert bright < 0.5 * alone


@pytest.mark.parametrize("longest", [0.05, 100.0])
def test_the_camera_of_a_scene_takes_the_same_light_in_all_shots_as_one_picture(
    longest: float, finger20: Scene
) -> None:
    colors = lambertian(finger20, 0.6)
    for shots in (1, 2, 3):
        camera = CameraModel(longest_exposure=longest, shots=shots)
        factor, gain, _ = camera.exposed(twice(colors, shots).reshape(-1))
        time = shots * factor / gain
        assert time == pytest.approx(min(255.0 / colors.max(), longest), rel=0.02)
        # Without a gain of its own a shot is as dark as a part of one picture.
        plain = replace(camera, gains=(1.0,))
        darker, one, _ = plain.exposed(twice(colors, shots).reshape(-1))
        assert (one, darker) == (1.0, pytest.approx(time / shots))


@pytest.mark.parametrize("gains", [(), (1.0,)])
@pytest.mark.parametrize("longest", [0.5, 100.0])
@pytest.mark.parametrize("kind", [SensorError, PlaceError])
def test_slopes_of_shots_are_those_of_differences_at_their_own_exposure(
    kind: type, longest: float, gains: tuple[float, ...], finger20: Scene
) -> None:
    camera = CameraModel(longest_exposure=longest, gains=gains, shots=2)
    rng, error = np.random.default_rng(3), kind(finger20, camera)
    colors = twice(lambertian(finger20, 0.6), 2)
    colors = colors * rng.uniform(0.7, 1.0, colors.shape)
    value, slopes = error.slopes(colors)
    assert value == pytest.approx(error.degrees(colors[None])[0])
    step = 1e-4 * rng.standard_normal(colors.shape) * colors
    up, down = error.degrees(np.stack([colors + step, colors - step]))
    assert 2.0 * (slopes * step).sum() == pytest.approx(up - down, rel=1e-5, abs=1e-9)


def test_readers_of_drawn_pictures_agree_that_it_is_one_picture(finger20: Scene) -> None:
    colors = lambertian(finger20, 0.6)
    one = reading(finger20, colors, DIM, range(3))
    two = reading(finger20, twice(colors, 2), replace(DIM, shots=2), range(3))
    assert two.place.mean == pytest.approx(one.place.mean, rel=0.02)
    # Of as many lessons a reader of twice the channels learns a little less.
    assert two.sensor.mean == pytest.approx(one.sensor.mean, rel=0.06)
