"""The analog lobe against its own integral, and against a skin without one."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from render.scene import unchecked
from tests.oracles.analog_cells import AnalogScene, analog_lamp, site_centers
from tests.oracles.analog_tracer import ENDS
from tests.oracles.pads import scene_of_case
from tests.oracles.skin_lobe import leave_skin, lobe_value

TILTED = np.array([0.36, -0.48, -0.8])


def grid(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return directions ``(direction, 3)`` over the hemisphere about -z, and solid angles."""
    # Bands of the same height, so that none lies across the borders below.
    cosine, turned = np.meshgrid(
        (np.arange(count) + 0.5) / count, np.pi * (np.arange(count) + 0.5) / (0.5 * count),
        indexing="ij",
    )  # fmt: skip
    sine = np.sqrt(1 - cosine**2)
    away = np.stack([sine * np.cos(turned), sine * np.sin(turned), -cosine], axis=-1)
    return away.reshape(-1, 3), np.full(count**2, 2 * np.pi / count**2)


@pytest.mark.parametrize("alpha", [0.1, 0.3, 0.5])
def test_photons_leave_the_skin_as_its_lobe_says(alpha: float) -> None:
    pad = AnalogScene(scene_of_case("sharp lobe")).pad._replace(
        albedo=0.0, specular=1.0, lobe=alpha
    )
    down, ends = np.array([0.0, 0.0, -1.0]), np.zeros(ENDS)
    arriving = np.array([0.6, 0.0, 0.8])
    away, solid = grid(300)
    f = np.array([lobe_value(arriving, -each, down, alpha) for each in away])
    flux = f * -away[:, 2] * solid
    state, count = np.full(1, 5, dtype=np.uint64), 100_000
    left, weights = np.zeros((count, 3)), np.zeros(count)
    for i in range(count):
        left[i] = arriving
        weights[i] = leave_skin(state, pad, left[i], down, 1.0, ends)
    assert weights.mean() == pytest.approx(flux.sum(), abs=4 * stats.sem(weights) + 1e-3)
    assert weights.mean() + ends.sum() / count == pytest.approx(1.0)
    for low, high in ((0.0, 0.6), (0.6, 0.75), (0.75, 0.85), (0.85, 1.0)):
        for way in (-1.0, 1.0):

            def within(
                d: np.ndarray, low: float = low, high: float = high, way: float = way
            ) -> np.ndarray:
                return (-d[:, 2] > low) & (-d[:, 2] <= high) & (way * d[:, 1] > 0)

            chosen = np.where(within(left), weights, 0.0)
            expected = flux[within(away)].sum()
            assert chosen.mean() == pytest.approx(expected, abs=4.5 * stats.sem(chosen) + 1e-3)


def test_the_lobe_is_the_same_both_ways_and_on_tilted_facets() -> None:
    one, other = np.array([-0.48, 0.64, 0.6]), np.array([0.0, 0.28, 0.96])
    there, back = (lobe_value(*pair, TILTED, 0.3) for pair in ((one, other), (other, one)))
    assert there == pytest.approx(back, rel=1e-12)
    assert there > 0.0


@pytest.mark.slow
def test_a_lobe_without_light_leaves_what_power_per_area_says() -> None:
    scene = scene_of_case("rough 0.1")
    analog = AnalogScene(scene, views=5000)
    plain = analog.cells(0, 1.2, 800_000)
    paired = analog._with_lobe(0, 1.2, 800_000, 16)
    error = np.hypot(plain.se, stats.sem(paired, axis=0))
    assert np.abs((paired.mean(axis=0) - plain.T) / error).max() < 4.5


@pytest.mark.slow
def test_a_spot_without_faces_sends_the_camera_the_lobe_times_its_irradiance() -> None:
    """Light comes straight from the lamp there, from about one direction."""
    scene = scene_of_case("sharp lobe no face")
    glossy = unchecked(scene.coating, {"albedo": 0.0, "specular": 0.5, "roughness": 0.5})
    scene = unchecked(scene, {"coating": glossy})
    analog = AnalogScene(scene, indented=False)
    found = analog.cells(0, 1.2, 3_000_000)
    received = (analog.irradiance(0, 1.2, 3_000_000, 16) @ analog.view.T).mean(axis=0)
    lamp, down = analog_lamp(scene, 0, 1.2), np.array([0.0, 0.0, -1.0])
    for site, (x, y) in enumerate(site_centers(scene)):
        spot = np.array([x, y, scene.pad.thickness])
        d, view = spot - lamp.center, spot - np.array(scene.camera.place)
        f = lobe_value(d / np.linalg.norm(d), view / np.linalg.norm(view), down, 0.5)
        expected = 0.5 * f * received[site]
        assert found.T[site] == pytest.approx(expected, rel=0.05, abs=4 * found.se[site])
