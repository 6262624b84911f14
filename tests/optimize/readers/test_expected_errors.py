"""Expected errors of readers: exact derivatives, and the Cramer-Rao bound where it must hold."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from optimize.design import baseline_design
from optimize.readers import CameraModel, ExposedColors, PlaceError, SensorError, reading
from optimize.readers.normals import sphere_metric, spread_normals
from optimize.scoring import predicted_colors
from render.scene import Scene
from surrogate.runtime import Checker
from tests.optimize.readers.test_reading import lambertian

KINDS = [SensorError, PlaceError]


THIRDS = 2 * np.pi * np.arange(3) / 3


def tilted_lights(
    scene: Scene, slant: float, level: float, lights: np.ndarray = THIRDS
) -> np.ndarray:
    """Return colors that are linear in the normal's parts along x and y, under three lights.

    As of a Lambertian plane at small slopes with ``lights`` at three azimuths, ``slant`` rad from
    its axis; Fisher's information is then one matrix everywhere. ``level`` counts on the pad.
    """
    faces, slope = scene.indenter.faces, np.sin(scene.indenter.slope)
    azimuth = 2 * np.pi * np.arange(faces) / faces
    shade = 1.0 + slope * np.tan(slant) * np.cos(azimuth[:, None] - lights)
    colors = level * np.concatenate([shade, np.ones((1, 3))])
    return np.broadcast_to(colors, (len(scene.state_axis), scene.sites.count, *colors.shape))


@pytest.mark.parametrize("kind", KINDS)
def test_slopes_are_those_of_differences(
    kind: type, finger20: Scene, finger20_checker: Checker
) -> None:
    error, rng = kind(finger20, CameraModel()), np.random.default_rng(2)
    colors = predicted_colors(finger20_checker, baseline_design(finger20))[None]
    gain = np.array([1.5])
    value, slopes, by_gain = error.exposed_slopes(colors, gain)
    assert value == pytest.approx(error.exposed_degrees(colors, gain))
    for _ in range(4):
        step = 1e-3 * rng.standard_normal(colors.shape)
        difference = error.exposed_degrees(colors + step, gain) - error.exposed_degrees(
            colors - step, gain
        )
        assert 2.0 * (slopes * step).sum() == pytest.approx(float(difference[0]), rel=1e-5)
    difference = error.exposed_degrees(colors, gain + 1e-4) - error.exposed_degrees(
        colors, gain - 1e-4
    )
    assert 2e-4 * by_gain == pytest.approx(difference, rel=1e-5)


@pytest.mark.parametrize("kind", KINDS)
def test_many_designs_at_once_are_told_what_each_is_told_alone(kind: type, finger20: Scene) -> None:
    colors = np.stack([tilted_lights(finger20, slant, 90.0) for slant in (0.5, 0.7, 0.9)])
    error, gain = kind(finger20, CameraModel()), np.array([1.0, 2.0, 1.0])
    together = error.exposed_degrees(colors, gain)
    alone = [float(error.exposed_degrees(colors[i : i + 1], gain[i : i + 1])[0]) for i in range(3)]
    assert together == pytest.approx(alone)


def test_both_readers_reach_the_cramer_rao_bound_where_light_is_linear(finger20: Scene) -> None:
    # Read noise alone: far below the range of colors, far above what the grid of the lookup misses.
    camera = CameraModel(read_noise=3.0, full_well=1e12, bits=16)
    slant, level = 0.6, 100.0
    colors = tilted_lights(finger20, slant, level)
    exposed = ExposedColors.of(colors, camera)
    ways = np.stack([np.sin(THIRDS), np.cos(THIRDS)], axis=1)
    jacobian = exposed.factor * level * np.tan(slant) * ways
    covariance = camera.read_noise**2 * np.linalg.inv(jacobian.T @ jacobian)
    tilt, azimuth = (part[0, 0] for part in spread_normals(1, 1, 200))
    slope = np.sin(finger20.indenter.slope)
    plane = slope * np.stack([tilt * np.sin(azimuth), tilt * np.cos(azimuth)], axis=-1)
    trace = np.einsum("ij,nji->n", covariance, sphere_metric(plane))
    bound = np.degrees(np.sqrt(np.pi / 4 * trace)).mean()
    found = reading(finger20, colors, camera)
    assert found.sensor.mean == pytest.approx(bound, rel=0.05)
    assert found.place.mean == pytest.approx(bound, rel=0.08)
    for kind in KINDS:
        expected = kind(finger20, camera).exposed_degrees(exposed.colors[None], np.ones(1))
        assert expected[0] == pytest.approx(bound, rel=0.05)


@pytest.mark.parametrize("kind", KINDS)
def test_more_contrast_is_never_expected_to_read_worse(kind: type, finger20: Scene) -> None:
    error = kind(finger20, CameraModel())
    colors = np.stack([lambertian(finger20, contrast) for contrast in (0.05, 0.1, 0.2, 0.4, 0.8)])
    assert (np.diff(error.exposed_degrees(colors, np.ones(5))) < 0.0).all()


@pytest.mark.parametrize("kind", KINDS)
def test_three_lights_over_a_plane_are_best_120_degrees_apart(kind: type, finger20: Scene) -> None:
    # Spence and Chantler (2006); of the slant they say 54.7 deg where the albedo is unknown.
    error, rng = kind(finger20, CameraModel(full_well=1e12)), np.random.default_rng(4)

    def degrees(others: np.ndarray) -> float:
        lights = np.array([0.0, *others])
        return float(
            error.exposed_degrees(tilted_lights(finger20, 0.6, 100.0, lights)[None], np.ones(1))[0]
        )

    for _ in range(3):
        found = minimize(degrees, rng.uniform(0.5, 5.8, 2), method="Nelder-Mead").x
        # A light and the one across from it tell the same where the albedo is known, as it is to a
        # reader: so axes are compared, 60 deg apart for lights 120 deg apart.
        apart = np.diff(np.sort(np.append(found % np.pi, [0.0, np.pi])))
        assert np.degrees(apart) == pytest.approx(60.0, abs=3.0)
