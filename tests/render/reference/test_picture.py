"""Pictures of level 2: what is pressed in, and smoothing that leaves its edges alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from render.geometry import ball
from render.preview import Preview
from render.reference import Picture, render_image, smoothed
from tests.optimize.overnight.tiny import tiny_scene

ROWS, COLUMNS = 40, 30
LEFT = np.s_[5:-5, 3:12]


def two_faces(noise: float) -> Picture:
    """Return a picture of two flat faces that meet in the middle, the right one twice as bright."""
    normal = np.zeros((ROWS, COLUMNS, 3))
    normal[:, :15], normal[:, 15:] = [0.0, 0.0, -1.0], [0.5, 0.0, -np.sqrt(0.75)]
    light = np.where(np.arange(COLUMNS) < 15, 1.0, 2.0)[None, :, None] * np.ones((ROWS, 1, 3))
    error = noise * light
    rng = np.random.default_rng(0)
    return Picture(light + error * rng.standard_normal(light.shape), error, normal)


def test_faces_keep_their_light_up_to_the_edge() -> None:
    exact = two_faces(0.0)
    np.testing.assert_allclose(smoothed(exact).radiance, exact.radiance, atol=1e-4)


def test_noise_falls_and_the_error_bars_say_by_how_much() -> None:
    noisy, exact = two_faces(0.4), two_faces(0.0)
    found = smoothed(noisy)
    error = (found.radiance - exact.radiance)[LEFT]
    assert error.std() < 0.4 / 5
    assert error.std() == pytest.approx(float(np.sqrt((found.se[LEFT] ** 2).mean())), rel=0.3)
    assert abs(error.mean()) < 0.02
    assert found.noise < 0.2 * noisy.noise


@pytest.mark.parametrize("bend", [0.0, np.pi / 4])
def test_both_levels_press_the_same_body_into_the_same_place(bend: float, tmp_path: Path) -> None:
    scene, size = tiny_scene(tmp_path), {"width": 54, "height": 90}
    body, phi = ball(scene), np.full(5, np.pi / 2)
    power = np.repeat(np.eye(5)[:, :1], 3, axis=1)
    with Preview(scene, imprint=body) as preview:
        pressed, untouched = (
            preview.picture(phi, power, bend, *size.values(), indented=way)[..., 0]
            for way in (True, False)
        )
    bodies = [
        render_image(scene, phi, power, bend, samples=1, imprint=body, **size),
        render_image(scene, phi, power, bend, samples=1, indented=False, **size),
    ]
    tilted = np.abs(bodies[0].normal - bodies[1].normal).max(axis=-1) > 0.15
    assert tilted.sum() > 40
    np.testing.assert_array_equal(bodies[0].coated[20:-5], untouched[20:-5] > 0)
    ratio = pressed / np.where(untouched > 0, untouched, np.nan)
    # All of the body is drawn there; elsewhere there is nothing but its shadow.
    assert (np.abs(ratio - 1.0) > 0.03)[tilted].mean() > 0.9
    row, column = (np.unique(index) for index in np.nonzero(tilted))
    beside = np.ones(tilted.shape, dtype=bool)
    beside[row[0] - 1 : row[-1] + 2, column[0] - 1 : column[-1] + 2] = False
    assert np.nanmax(ratio[beside]) < 1.001
    assert ratio[tilted].max() > 1.1
