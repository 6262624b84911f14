"""Lanes that share light subpaths: who joins whom, and where on the film they look."""

from __future__ import annotations

from types import ModuleType

import numpy as np
import pytest

from render.integrators.vertex_cache import Ensemble

PATHS = 8


@pytest.mark.parametrize(("lanes", "groups"), [(1024, 16), (1000, 7), (64, 3)])
def test_every_light_subpath_serves_as_many_camera_subpaths_all_of_its_own_group(
    mono: ModuleType, lanes: int, groups: int
) -> None:
    ensemble = Ensemble(lanes, groups, PATHS)
    lane = np.arange(lanes)
    partners = np.array([np.array(ensemble.partner(ensemble.lane, k)) for k in range(PATHS)])
    np.testing.assert_array_equal(partners[0], lane)
    assert (partners % groups == lane % groups).all()
    assert (np.diff(np.sort(partners, axis=0), axis=0) > 0).all()
    assert (np.bincount(partners.ravel(), minlength=lanes) == PATHS).all()


def test_a_group_smaller_than_the_shared_paths_still_serves_its_members_alike(
    mono: ModuleType,
) -> None:
    ensemble = Ensemble(12, 4, PATHS)
    partners = np.array([np.array(ensemble.partner(ensemble.lane, k)) for k in range(PATHS)])
    assert (np.bincount(partners.ravel(), minlength=12) == PATHS).all()


@pytest.mark.parametrize(("lanes", "groups"), [(4096, 16), (1000, 7), (24, 8)])
def test_each_group_has_one_film_position_per_stratum(
    mono: ModuleType, lanes: int, groups: int
) -> None:
    numbers = [
        mono.Float(np.random.default_rng(i).random(lanes).astype(np.float32)) for i in range(3)
    ]
    place, weight = Ensemble(lanes, groups, PATHS).placed(numbers, 8)
    x, y = (np.array(c, dtype=np.float64) for c in (place.x, place.y))
    assert (np.array(weight) == 1).all()
    along = (np.floor(y * 8) + x) / 8
    for group in range(groups):
        mine = along[group::groups]
        strata = np.floor(mine * len(mine))
        np.testing.assert_array_equal(np.sort(strata), np.arange(len(mine)))


def test_film_positions_follow_a_density_and_are_weighted_by_its_inverse(
    mono: ModuleType,
) -> None:
    lanes = 1 << 14
    rng = np.random.default_rng(5)
    density = rng.random((8, 12)) + 0.1
    numbers = [mono.Float(rng.random(lanes).astype(np.float32)) for _ in range(3)]
    place, weight = Ensemble(lanes, 4, PATHS, density).placed(numbers, 8)
    pixel = np.floor(np.array(place.y) * 8) * 12 + np.floor(np.array(place.x) * 12)
    share = np.bincount(pixel.astype(int), minlength=96) / lanes
    expected = density.ravel() / density.sum()
    # Four groups of 4096 strata: the counts can be off by one stratum at either end.
    np.testing.assert_allclose(share, expected, atol=8 / lanes)
    np.testing.assert_allclose(np.array(weight), 1 / (96 * expected[pixel.astype(int)]), rtol=1e-3)
