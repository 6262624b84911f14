"""Normals come back from colors: exactly without noise, worse with less light or less contrast."""

from __future__ import annotations

import numpy as np
import pytest

from optimize.reconstruction.normal_reconstruction import (
    CameraNoise,
    NormalColors,
    compare_reconstruction,
    reconstruct,
)
from render.scene import Scene

QUIET = CameraNoise(read=0.0, full_well=1e12)


def lambertian(scene: Scene, contrast: float) -> tuple[np.ndarray, np.ndarray]:
    """Return colors of facets under three lights from three sides (eq. 4.3), and of the pad."""
    azimuth = 2 * np.pi * np.arange(scene.indenter.faces) / scene.indenter.faces
    lights = 2 * np.pi * np.arange(3) / 3
    shade = 120.0 * (1.0 + contrast * np.cos(azimuth[:, None] - lights))
    shape = (len(scene.bending.angles), scene.sites.count)
    facets = np.broadcast_to(shade, (*shape, *shade.shape))
    return facets, np.full((*shape, 3), 120.0)


def test_colors_between_facets_follow_the_cosine(finger20: Scene) -> None:
    facets, pad = lambertian(finger20, 0.6)
    tilt = np.full((*pad.shape[:2], 5), 0.5)
    azimuth = np.broadcast_to(np.linspace(0.1, 2.0, 5), tilt.shape)
    found = NormalColors(facets, pad).at(tilt, azimuth)
    lights = 2 * np.pi * np.arange(3) / 3
    assert found == pytest.approx(
        120.0 * (1.0 + 0.3 * np.cos(azimuth[..., None] - lights)), rel=1e-9
    )
    whole = 2 * np.pi * np.arange(finger20.indenter.faces) / finger20.indenter.faces
    shape = (*pad.shape[:2], len(whole))
    at_facets = NormalColors(facets, pad).at(np.ones(shape), np.broadcast_to(whole, shape))
    assert at_facets == pytest.approx(facets)


def test_without_noise_only_the_grid_is_left(finger20: Scene) -> None:
    colors = lambertian(finger20, 0.6)
    found = reconstruct(finger20, colors, colors, QUIET, seed=0)
    assert found.lookup.max() < 2.0
    assert found.regressor.mean() < 0.3


def test_noise_and_flat_light_cost_degrees(finger20: Scene) -> None:
    noise = CameraNoise(read=4.0)
    steep, flat = lambertian(finger20, 0.6), lambertian(finger20, 0.2)
    found = compare_reconstruction(finger20, [flat, steep], [flat, steep], noise, range(2))
    assert set(found) == {"lookup_mean", "lookup_95%", "regressor_mean", "regressor_95%"}
    for entry in found.values():
        assert entry.interval[1] < 0.0
        assert entry.design < entry.baseline
    quiet = compare_reconstruction(finger20, [flat, steep], [flat, steep], QUIET, range(2))
    assert quiet["lookup_mean"].design < found["lookup_mean"].design


def test_ambiguous_colors_are_read_wrongly(finger20: Scene) -> None:
    facets, pad = lambertian(finger20, 0.6)
    gray = np.repeat(facets.mean(axis=-1, keepdims=True), 3, axis=-1), pad
    found = reconstruct(finger20, gray, gray, CameraNoise(), seed=0)
    assert found.lookup.mean() > 10.0
