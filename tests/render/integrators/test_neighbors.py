"""Light vertices near a point: which of its group they are, and that each counts once."""

from __future__ import annotations

from types import ModuleType

import drjit as dr
import numpy as np
import pytest

from render.integrators.light_subpaths import LightVertex
from render.integrators.neighbors import WINDOW, Nearby
from render.integrators.proxy_weights import Seen
from render.integrators.vertex_cache import Ensemble

LANES, GROUPS, PATHS, DRAWS = 1 << 13, 4, 16, 8


def scattered(mono: ModuleType, points: np.ndarray, power: np.ndarray) -> Seen:
    record = LightVertex.empty()
    record.vertex.p = mono.Point3f(points.astype(np.float32))
    record.vertex.wi = dr.zeros(mono.Vector3f, points.shape[1])
    record.vertex.beta = mono.Spectrum(1.0)
    return Seen.of(record, mono.Float(power.astype(np.float32)))


def nearby(mono: ModuleType, points: np.ndarray, power: np.ndarray) -> Nearby:
    """Return the vertices ``points`` of two slots a lane, seen from points like them."""
    at = np.random.default_rng(2).standard_normal((3, LANES))
    ensemble = Ensemble(LANES, GROUPS, PATHS)
    return Nearby(scattered(mono, points, power), ensemble, mono.Point3f(at.astype(np.float32)))


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e4])
def test_what_is_drawn_nearby_stands_for_what_is_left_out_elsewhere(
    mono: ModuleType, scale: float
) -> None:
    rng = np.random.default_rng(1)
    points = scale * rng.standard_normal((3, 2 * LANES))
    power = np.where(rng.random(2 * LANES) < 0.3, 0.0, 1.0)
    near = nearby(mono, points, power)
    group = np.arange(LANES) % GROUPS
    value = rng.random(2 * LANES)
    value[power == 0] = 0.0
    # Of every lane's near vertices: their sum, and what the draws make of it.
    places = np.array(near.rank)
    mine = np.array(near.place)
    exact, lanes = 0.0, np.arange(0, LANES, 64)
    for lane in lanes:
        held = np.abs(places - mine[lane]) < WINDOW
        held &= np.arange(2 * LANES) % LANES % GROUPS == group[lane]
        exact += value[held].sum()
    found, members = [], LANES // GROUPS
    for _ in range(64):
        number = mono.Float(rng.random(LANES).astype(np.float32))
        _, place, stands_for = near.drawn(number, DRAWS)
        index = np.array(near.index(dr.clip(place, 0, 2 * LANES - 1)))
        weight = np.array(stands_for)
        assert (index[weight > 0] % LANES % GROUPS == group[weight > 0]).all()
        found.append((value[index] * weight)[lanes].sum() * DRAWS * members / PATHS)
    error = np.std(found, ddof=1) / np.sqrt(len(found))
    assert np.mean(found) == pytest.approx(exact, abs=4 * error)
    assert error < 0.05 * exact


def test_the_nearest_in_order_are_near_in_space(mono: ModuleType) -> None:
    rng = np.random.default_rng(3)
    points = rng.standard_normal((3, 2 * LANES))
    near = nearby(mono, points, np.ones(2 * LANES))
    at = np.random.default_rng(2).standard_normal((3, LANES))
    number = mono.Float(rng.random(LANES).astype(np.float32))
    y, _, stands_for = near.drawn(number, DRAWS)
    there = np.array(stands_for) > 0
    distance = np.linalg.norm(np.array(y.p) - at, axis=0)[there]
    other = np.linalg.norm(points[:, :LANES] - at, axis=0)
    assert np.median(distance) < 0.5 * np.median(other)


def test_where_no_light_subpath_left_a_vertex_nothing_is_near(mono: ModuleType) -> None:
    near = nearby(mono, np.zeros((3, 2 * LANES)), np.zeros(2 * LANES))
    _, _, stands_for = near.drawn(dr.full(mono.Float, 0.5, LANES), DRAWS)
    assert (np.array(stands_for) == 0).all()
