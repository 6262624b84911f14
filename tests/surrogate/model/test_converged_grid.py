"""The shader's grid, corrected by noisy light whose truth is known."""

from __future__ import annotations

import numpy as np
import pytest

from render.chebyshev import chebyshev_nodes
from render.preview.converged import ConvergedTransport
from render.scene import Scene
from surrogate.model.converged_grid import corrected, likely_ratio
from surrogate.model.preview_grid import PreviewGrid
from tests.small_scenes import small_scene

NODES = chebyshev_nodes(13, 0.0, np.pi)
PHOTON = 1e-3
"""Light of a photon."""


@pytest.fixture(scope="module")
def flat() -> Scene:
    return small_scene(bending={"angles": {"value": [0.0], "unit": "deg", "source": "flat"}})


def cells_of(scene: Scene) -> tuple[int, ...]:
    return scene.lamp_count, len(NODES), 1, scene.sites.count, scene.indenter.faces + 1


def ratio(scene: Scene, drawn: np.ndarray, light: np.ndarray, grain: float) -> np.ndarray:
    """Return corrected transport over ``drawn``."""
    grid = PreviewGrid(np.log(drawn), NODES, np.zeros(1), 0)
    found = ConvergedTransport(light, np.full(light.shape[:3], grain), np.zeros(light.shape[2]))
    return np.asarray(np.exp(corrected(grid, scene, found).log_transport) / drawn)


def photons(truth: np.ndarray, seed: int) -> np.ndarray:
    """Return light of Poisson distributed photons, which the cells of a site share."""
    site = truth.mean(axis=-1, keepdims=True)
    return np.asarray(np.random.default_rng(seed).poisson(site / PHOTON) * PHOTON * truth / site)


@pytest.mark.parametrize("count", [0.3, 3.0, 30.0])
@pytest.mark.parametrize("found", [0.0, 2.0, 40.0])
def test_the_likeliest_ratio_is_where_its_density_is_highest(found: float, count: float) -> None:
    r = np.exp(np.linspace(-4.0, 6.0, 1_000_001))
    density = found * np.log(r) - count * r - np.log(r) ** 2 / (2 * 0.6**2)
    grain = np.array([PHOTON])
    got = likely_ratio(np.array([found * PHOTON]), np.array([count * PHOTON]), grain, 0.6)
    assert got[0] == pytest.approx(r[density.argmax()], rel=2e-5)


def test_a_lamp_that_is_drawn_ten_times_too_dark_is_corrected(flat: Scene) -> None:
    truth = np.full(cells_of(flat), 20 * PHOTON)
    drawn = truth.copy()
    drawn[0] /= 10.0
    got = ratio(flat, drawn, photons(truth, 0), PHOTON)
    assert got[0].mean() == pytest.approx(10.0, rel=0.1)
    assert got[1:].mean() == pytest.approx(1.0, rel=0.05)


def test_a_site_that_is_drawn_ten_times_too_dark_is_corrected(flat: Scene) -> None:
    truth = np.full(cells_of(flat), 50 * PHOTON)
    drawn = truth.copy()
    drawn[:, :, :, 0] /= 10.0
    got = ratio(flat, drawn, photons(truth, 1), PHOTON)
    assert got[:, :, :, 0].mean() == pytest.approx(10.0, rel=0.15)


@pytest.mark.parametrize(("count", "bias"), [(0.5, 0.1), (5.0, 0.03), (50.0, 0.01)])
def test_noise_moves_what_is_right_by_less_than_itself(
    flat: Scene, count: float, bias: float
) -> None:
    truth = np.full(cells_of(flat), count * PHOTON)
    light = photons(truth, 2)
    got, noise = ratio(flat, truth, light, PHOTON), light / truth
    assert np.std(got) < np.std(noise)
    assert np.sqrt(np.mean(np.log(got) ** 2)) < 0.5  # in spite of sites without a photon
    # The likeliest logarithm is not the mean light's, least of all of half a photon a site.
    assert abs(got.mean() - noise.mean()) < bias


def test_many_photons_are_believed(flat: Scene) -> None:
    rng = np.random.default_rng(3)
    truth = np.exp(rng.normal(0.0, 1.0, cells_of(flat)))
    drawn = np.exp(rng.normal(0.0, 1.0, cells_of(flat)))
    got = ratio(flat, drawn, truth, 1e-9)
    np.testing.assert_allclose(got, truth / drawn, rtol=1e-4)


def test_light_without_grain_is_what_was_found(flat: Scene) -> None:
    rng = np.random.default_rng(4)
    truth, drawn = rng.uniform(0.1, 10.0, (2, *cells_of(flat)))
    np.testing.assert_allclose(ratio(flat, drawn, truth, 0.0), truth / drawn, rtol=1e-12)
