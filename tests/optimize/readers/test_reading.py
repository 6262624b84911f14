"""Normals come back from colors: exactly without noise, worse with less light or less contrast."""

from __future__ import annotations

import numpy as np
import pytest

from optimize.readers import (
    CameraModel,
    ExposedColors,
    compare_readings,
    reading,
    saturating_tilts,
)
from optimize.readers.model_colors import drawn_errors
from optimize.readers.normal_colors import color_weights, colors_of_normals, weight_slopes
from optimize.readers.reading import AngleErrors, read_normals
from render.scene import Scene, unchecked

QUIET = CameraModel(read_noise=0.0, full_well=1e12, bits=16)


def lambertian(scene: Scene, contrast: float) -> np.ndarray:
    """Return colors of facets under three lights from three sides (eq. 4.3), and of the pad."""
    azimuth = 2 * np.pi * np.arange(scene.indenter.faces) / scene.indenter.faces
    lights = 2 * np.pi * np.arange(3) / 3
    shade = 120.0 * (1.0 + contrast * np.cos(azimuth[:, None] - lights))
    colors = np.concatenate([shade, np.full((1, 3), 120.0)])
    return np.broadcast_to(colors, (len(scene.bending.angles), scene.sites.count, *colors.shape))


def errors(scene: Scene, colors: np.ndarray, camera: CameraModel) -> AngleErrors:
    exposed = ExposedColors.of(colors, camera)
    return read_normals(scene, exposed, exposed, camera, seed=0)


def test_colors_between_facets_follow_the_cosine(finger20: Scene) -> None:
    colors = lambertian(finger20, 0.6)
    tilt = np.full((*colors.shape[:2], 5), 0.5)
    azimuth = np.broadcast_to(np.linspace(0.1, 2.0, 5), tilt.shape)
    found = colors_of_normals(colors, tilt, azimuth)
    lights = 2 * np.pi * np.arange(3) / 3
    assert found == pytest.approx(
        120.0 * (1.0 + 0.3 * np.cos(azimuth[..., None] - lights)), rel=1e-9
    )
    faces = finger20.indenter.faces
    whole = 2 * np.pi * np.arange(faces) / faces
    at_facets = colors_of_normals(colors, np.ones(faces), whole)
    assert at_facets == pytest.approx(colors[:, :, :-1])


def test_weights_of_colors_have_the_slopes_of_their_differences() -> None:
    rng, step = np.random.default_rng(3), 1e-6
    plane = rng.uniform(-0.3, 0.3, (20, 2))
    slope = 0.5

    def weights(at: np.ndarray) -> np.ndarray:
        tilt = np.hypot(at[:, 0], at[:, 1]) / slope
        return color_weights(10, tilt, np.arctan2(at[:, 0], at[:, 1]))

    tilt, azimuth = np.hypot(*plane.T) / slope, np.arctan2(*plane.T)
    exact = weight_slopes(10, tilt, azimuth, slope)
    for axis in range(2):
        moved = step * np.eye(2)[axis]
        difference = (weights(plane + moved) - weights(plane - moved)) / (2 * step)
        assert exact[..., axis] == pytest.approx(difference, abs=1e-7)


def test_without_noise_only_the_grid_is_left(finger20: Scene) -> None:
    found = errors(finger20, lambertian(finger20, 0.6), QUIET)
    assert found.place.max() < 2.0
    assert found.sensor.mean() < 0.3


def test_noise_and_flat_light_cost_degrees(finger20: Scene) -> None:
    camera = CameraModel(read_noise=4.0)
    pair = [lambertian(finger20, contrast) for contrast in (0.2, 0.6)]
    found = compare_readings(*(reading(finger20, one, camera, range(2)) for one in pair))
    assert set(found) == {"lookup_mean", "lookup_95%", "regressor_mean", "regressor_95%"}
    for entry in found.values():
        assert entry.interval[1] < 0.0
        assert entry.design < entry.baseline
    quiet = compare_readings(*(reading(finger20, one, QUIET, range(2)) for one in pair))
    assert quiet["lookup_mean"].design < found["lookup_mean"].design


def test_ambiguous_colors_are_read_wrongly(finger20: Scene) -> None:
    colors = lambertian(finger20, 0.6)
    gray = np.repeat(colors.mean(axis=-1, keepdims=True), 3, axis=-1)
    found = errors(finger20, gray, CameraModel())
    assert found.place.mean() > 10.0
    assert found.sensor.mean() > 10.0


def test_a_brighter_lamp_is_no_gain_where_the_camera_exposes_for_it(finger20: Scene) -> None:
    colors = lambertian(finger20, 0.6)
    one, other = reading(finger20, colors), reading(finger20, 2.5 * colors)
    assert other.factor == pytest.approx(one.factor / 2.5)
    assert other.sensor.mean == pytest.approx(one.sensor.mean)
    assert other.place.mean == pytest.approx(one.place.mean)


def test_a_design_that_wants_more_than_the_longest_exposure_pays_in_noise(finger20: Scene) -> None:
    colors = lambertian(finger20, 0.6)
    bright, dark = reading(finger20, colors), reading(finger20, colors / 40.0)
    assert bright.gain == 1.0
    assert dark.gain == pytest.approx(dark.factor / CameraModel().longest_exposure)
    assert dark.sensor.mean > 1.5 * bright.sensor.mean
    assert dark.place.mean > 1.5 * bright.place.mean


def test_no_more_than_the_stated_fraction_saturates() -> None:
    rng = np.random.default_rng(1)
    counts = rng.gamma(2.0, 30.0, (4, 20_000))
    for fraction in (0.001, 0.02):
        factor, _, decides = CameraModel(saturated=fraction).exposed(counts)
        exposed = factor[:, None] * counts
        assert (exposed > 255.0 * (1 + 1e-12)).mean(axis=1) == pytest.approx(fraction, abs=1e-4)
        assert exposed[np.arange(4), decides] == pytest.approx(255.0)


def test_what_is_dark_keeps_the_exposure_of_its_scene() -> None:
    factor, gain, _ = CameraModel().exposed(np.zeros((1, 50)))
    assert factor == gain == 1.0


def camera_of(finger20: Scene, **keys: object) -> CameraModel:
    """Return the camera of a scene whose ``[camera]`` says ``keys``."""
    return CameraModel.of(unchecked(finger20, {"camera": unchecked(finger20.camera, keys)}))


def test_a_scene_says_what_its_camera_limits_and_what_is_assumed(finger20: Scene) -> None:
    assert CameraModel.of(finger20) == CameraModel()
    assert "assumed, as [camera] does not say it: read_noise" in CameraModel().sentence
    found = camera_of(finger20, read_noise=3.0, full_well=5000.0, bits=10, longest_exposure=2.0,
                      gains=(4.0, 1.0), saturated=0.01)  # fmt: skip
    assert (found.read_noise, found.full_well) == (3.0, 5000.0)
    assert (found.bits, found.longest_exposure) == (10, 2.0)
    assert (found.gains, found.saturated, found.assumed) == ((1.0, 4.0), 0.01, ())
    assert "assumed" not in found.sentence
    noisier = CameraModel.of(finger20).stating(read_noise=2.0, full_well=None)
    assert noisier.read_noise == 2.0
    assert "read_noise" not in noisier.assumed
    assert "full_well" in noisier.assumed


@pytest.mark.parametrize(
    ("brightest", "factor", "gain"),
    [(255.0, 1.0, 1.0), (127.5, 2.0, 1.0), (64.0, 255.0 / 64.0, 4.0), (25.5, 8.0, 4.0)],
)
def test_gain_goes_in_the_steps_that_a_camera_has_and_ends_with_them(
    finger20: Scene, brightest: float, factor: float, gain: float
) -> None:
    camera = camera_of(finger20, longest_exposure=2.0, gains=(1.0, 4.0), saturated=0.0)
    found = camera.exposed(np.array([1.0, brightest, 2.0]))
    assert [float(part) for part in found[:2]] == pytest.approx([factor, gain])


def test_a_channel_saturates_from_the_tilt_at_which_its_color_reaches_full_scale(
    finger20: Scene,
) -> None:
    # 200 counts on the pad and 300 on the facet that is turned to the light: linear in the sine.
    azimuth = 2 * np.pi * np.arange(finger20.indenter.faces) / finger20.indenter.faces
    colors = np.concatenate(
        [200.0 + 100.0 * np.cos(azimuth)[:, None] * [1.0, 0.0, 0.4], np.full((1, 3), 200.0)]
    )
    colors = np.broadcast_to(
        colors, (len(finger20.state_axis), finger20.sites.count, *colors.shape)
    )
    red, green, blue = saturating_tilts(finger20, colors)
    exact = np.degrees(np.arcsin(0.55 * np.sin(finger20.indenter.slope)))
    assert red == pytest.approx(exact, abs=np.degrees(finger20.indenter.slope) / 40)
    assert green is None
    assert blue is None


def likely(colors: np.ndarray, error: float) -> np.ndarray:
    """Return errors that are likely where a lamp in each channel is off by ``error``, relative."""
    lamps = [(colors * (np.arange(3) == channel), [channel]) for channel in range(3)]
    return drawn_errors(error * colors, lamps)


def test_what_a_model_may_be_off_by_is_in_intervals_of_readings(finger20: Scene) -> None:
    colors = lambertian(finger20, 0.6)
    plain = reading(finger20, colors, seeds=range(4))
    rng = np.random.default_rng(0)
    for error in (0.01, 0.03):
        known = reading(finger20, colors, seeds=range(4), errors=likely(colors, error))
        for reader in ("sensor", "place"):
            figures, alone = getattr(known, reader), getattr(plain, reader)
            low, high = figures.interval
            assert high - low > alone.interval[1] - alone.interval[0]
            # Colors as likely as the model's are read to within the interval.
            held = []
            for _ in range(12):
                off = 1.0 + error * rng.standard_normal(colors.shape)
                true = reading(finger20, colors * off, seeds=range(4))
                held.append(low <= getattr(true, reader).mean <= high)
            assert np.mean(held) >= 0.75


def test_readings_of_one_model_that_agree_have_no_difference(finger20: Scene) -> None:
    colors = lambertian(finger20, 0.6)
    both = [reading(finger20, colors, errors=likely(colors, 0.02)) for _ in range(2)]
    for one in compare_readings(*both).values():
        assert (one.difference, one.interval) == (0.0, (0.0, 0.0))
