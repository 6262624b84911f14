"""The light vertex cache: who shares vertices, where on the film, and which ones are near."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import drjit as dr
import numpy as np
import pytest

from render.integrators.resampling import LightProxies, PackedProxies
from render.integrators.subpaths import SubpathVertex
from render.integrators.vertex_cache import (
    NEIGHBOR_WINDOW,
    LaneGroups,
    MortonNeighbors,
)
from render.paths.records import PackedRecords

PATHS = 8
LANES, GROUPS, NEAR_PATHS, DRAWS = 1 << 13, 4, 16, 8


@pytest.mark.parametrize(("lanes", "groups"), [(1024, 16), (1000, 7), (64, 3)])
def test_every_light_subpath_serves_as_many_camera_subpaths_all_of_its_own_group(
    mono: ModuleType, lanes: int, groups: int
) -> None:
    lane_groups = LaneGroups(lanes, groups, PATHS)
    lane = np.arange(lanes)
    partners = np.array([np.array(lane_groups.partner(k)) for k in range(PATHS)])
    np.testing.assert_array_equal(partners[0], lane)
    assert (partners % groups == lane % groups).all()
    assert (np.diff(np.sort(partners, axis=0), axis=0) > 0).all()
    assert (np.bincount(partners.ravel(), minlength=lanes) == PATHS).all()


def test_a_group_smaller_than_the_shared_paths_still_serves_its_members_alike(
    mono: ModuleType,
) -> None:
    lane_groups = LaneGroups(12, 4, PATHS)
    partners = np.array([np.array(lane_groups.partner(k)) for k in range(lane_groups.path_count)])
    assert (np.bincount(partners.ravel(), minlength=12) == 3).all()
    assert (np.diff(np.sort(partners, axis=0), axis=0) > 0).all()


@pytest.mark.parametrize(("lanes", "groups"), [(4096, 16), (1000, 7), (24, 8)])
def test_each_group_has_one_film_position_per_stratum(
    mono: ModuleType, lanes: int, groups: int
) -> None:
    numbers = [
        mono.Float(np.random.default_rng(i).random(lanes).astype(np.float32)) for i in range(2)
    ]
    lane_groups = LaneGroups(lanes, groups, PATHS, rows=8)
    place = lane_groups.film_positions(lane_groups.lane, numbers)
    x, y = (np.array(c, dtype=np.float64) for c in (place.x, place.y))
    along = (np.floor(y * 8) + x) / 8
    for group in range(groups):
        mine = along[group::groups]
        strata = np.floor(mine * len(mine))
        np.testing.assert_array_equal(np.sort(strata), np.arange(len(mine)))


def scattered(mono: ModuleType, points: np.ndarray, power: np.ndarray) -> LightProxies:
    record = SubpathVertex.none()
    record.vertex.p = mono.Point3f(points.astype(np.float32))
    record.vertex.wi = dr.zeros(mono.Vector3f, points.shape[1])
    record.vertex.beta = mono.Spectrum(1.0)
    return LightProxies.of(record, mono.Float(power.astype(np.float32)))


def nearby(mono: ModuleType, points: np.ndarray, power: np.ndarray) -> MortonNeighbors:
    """Return the vertices ``points`` of two slots a lane, seen from points like them."""
    at = np.random.default_rng(2).standard_normal((3, LANES))
    lane_groups = LaneGroups(LANES, GROUPS, NEAR_PATHS)
    return MortonNeighbors(
        PackedProxies(scattered(mono, points, power)),
        lane_groups,
        mono.Point3f(at.astype(np.float32)),
    )


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e4])
def test_what_is_drawn_nearby_represents_what_is_left_out_elsewhere(
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
        held = np.abs(places - mine[lane]) < NEIGHBOR_WINDOW
        held &= np.arange(2 * LANES) % LANES % GROUPS == group[lane]
        exact += value[held].sum()
    found, members = [], LANES // GROUPS
    for _ in range(64):
        number = mono.Float(rng.random(LANES).astype(np.float32))
        index, weight = (np.array(drawn) for drawn in near.sample(number, DRAWS))
        assert (index[weight > 0] % LANES % GROUPS == group[weight > 0]).all()
        found.append((value[index] * weight)[lanes].sum() * DRAWS * members / NEAR_PATHS)
    error = np.std(found, ddof=1) / np.sqrt(len(found))
    assert np.mean(found) == pytest.approx(exact, abs=4 * error)
    assert error < 0.05 * exact


def test_the_nearest_in_order_are_near_in_space(mono: ModuleType) -> None:
    rng = np.random.default_rng(3)
    points = rng.standard_normal((3, 2 * LANES))
    near = nearby(mono, points, np.ones(2 * LANES))
    at = np.random.default_rng(2).standard_normal((3, LANES))
    number = mono.Float(rng.random(LANES).astype(np.float32))
    index, weight = (np.array(drawn) for drawn in near.sample(number, DRAWS))
    distance = np.linalg.norm(points[:, index] - at, axis=0)[weight > 0]
    other = np.linalg.norm(points[:, :LANES] - at, axis=0)
    assert np.median(distance) < 0.5 * np.median(other)


def test_where_no_light_subpath_left_a_vertex_nothing_is_near(mono: ModuleType) -> None:
    near = nearby(mono, np.zeros((3, 2 * LANES)), np.zeros(2 * LANES))
    _, represented = near.sample(dr.full(mono.Float, 0.5, LANES), DRAWS)
    assert (np.array(represented) == 0).all()


def test_packed_proxies_are_the_proxies_bit_for_bit(mono: ModuleType) -> None:
    numbers = np.random.default_rng(1).normal(size=(11, 50)).astype(np.float32)
    number = np.arange(50)
    proxies = LightProxies(
        mono.Point3f(numbers[:3]), mono.Vector3f(numbers[3:6]), mono.Float(numbers[6]),
        mono.Float(numbers[10]), mono.Bool(number % 2 == 0), mono.Bool(number % 3 == 0),
        mono.UInt32(number * 40), mono.Float(numbers[7] * 1e30), mono.Float(numbers[8]),
        mono.Float(numbers[9]),
    )  # fmt: skip
    index = mono.UInt32(number[::-1].copy())
    expected = dr.gather(LightProxies, proxies, index)
    found = PackedProxies(proxies).gather(index)
    for name, value in vars(expected).items():
        assert np.array_equal(np.array(value), np.array(getattr(found, name))), name


def test_packed_light_vertices_are_the_vertices_bit_for_bit(mono: ModuleType) -> None:
    rng = np.random.default_rng(2)
    vertices, count = SubpathVertex.none(), 50

    def numbers(*shape: int) -> np.ndarray:
        return (rng.normal(size=(*shape, count)) * 1e20).astype(np.float32)

    def flags() -> Any:
        return mono.Bool(rng.random(count) < 0.5)

    v = vertices.vertex
    bsdf = mono.load_dict({"type": "diffuse"})
    v.bsdf = dr.select(flags(), mono.BSDFPtr(bsdf), dr.zeros(mono.BSDFPtr))
    v.p, v.n, v.wi = mono.Point3f(numbers(3)), mono.Normal3f(numbers(3)), mono.Vector3f(numbers(3))
    v.frame = mono.Frame3f(*(mono.Vector3f(numbers(3)) for _ in range(3)))
    v.uv, v.d_vc_passing = mono.Point2f(numbers(2)), mono.Vector2f(numbers(2))
    v.beta, v.d_vcm, v.d_vc, v.weight = (mono.Float(numbers()) for _ in range(4))
    v.beta = mono.Spectrum(v.beta)
    v.volume, v.diffuse, v.delta, v.terminal = (flags() for _ in range(4))
    vertices.previous, vertices.glossy_after_wide = mono.Point3f(numbers(3)), flags()
    vertices.edges = mono.UInt32(rng.integers(0, 1 << 32, count, dtype=np.uint32))
    active = flags()
    index = mono.UInt32(np.arange(count)[::-1].copy())
    expected = dr.gather(SubpathVertex, vertices, index, active)
    found = PackedRecords.of(vertices).gather(index, active)
    for name, value in vars(expected.vertex).items():
        other = getattr(found.vertex, name)
        pairs = [(value, other)]
        if name == "frame":
            pairs = [(getattr(value, axis), getattr(other, axis)) for axis in "stn"]
        assert all(dr.all(one == two, axis=None) for one, two in pairs), name
    for name in ("previous", "glossy_after_wide", "edges"):
        assert dr.all(getattr(expected, name) == getattr(found, name), axis=None), name
