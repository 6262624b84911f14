"""Directions that photons have told are drawn as often as they say, and find what others miss."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import drjit as dr
import numpy as np
import pytest

from render.geometry import facets
from render.reference import pad_cells
from render.sampling.monte_carlo import MonteCarlo
from tests.oracles.pads import scene_of_case

COUNT = 1 << 18
PHI = 1.2
SCENE = scene_of_case("smooth bent 45")
BEND = float(SCENE.bending.angles[0])


@pytest.fixture(scope="module")
def cells(mono: ModuleType) -> Any:
    phi = np.full((SCENE.lamp_count, 1), PHI)
    return pad_cells(SCENE, phi, BEND, True, sampler="monte-carlo")


def on_facet(mono: ModuleType, site: int, facet: int) -> Any:
    from render.paths.vertex import empty_vertex

    place, v = facets(SCENE, BEND), empty_vertex()
    v.p = mono.Point3f(*place.centroid[site, facet].tolist())
    v.n = mono.Normal3f(*place.normal[site, facet].tolist())
    return v


def numbers(mono: ModuleType, seed: int) -> list[Any]:
    rng = np.random.default_rng(seed)
    return [mono.Float(rng.random(COUNT).astype(np.float32)) for _ in range(3)]


@pytest.mark.parametrize(("fiber", "site", "facet"), [(0, 0, 0), (1, 5, 2), (0, 4, 1)])
def test_the_density_is_that_of_the_sampled_directions(
    mono: ModuleType, cells: Any, fiber: int, site: int, facet: int
) -> None:
    check_density(mono, cells, fiber, on_facet(mono, site, facet))


def test_where_no_photon_came_all_directions_are_alike(mono: ModuleType, cells: Any) -> None:
    v = on_facet(mono, 0, 0)
    v.p = v.p + 1000.0
    check_density(mono, cells, 0, v)
    density = cells.ways[0].density(mono.UInt32(0), v, mono.Vector3f(0.6, 0.0, 0.8))
    assert np.array(density) == pytest.approx(1 / (4 * np.pi))


def check_density(mono: ModuleType, cells: Any, fiber: int, v: Any) -> None:
    fibers = dr.full(mono.UInt32, fiber, COUNT)
    pick, x, y = numbers(mono, 1)
    drawn = cells.ways[0].sample(fibers, v, pick, x, y)
    anywhere = mono.warp.square_to_uniform_sphere(mono.Point2f(x, y))
    weight = 4 * np.pi * np.array(cells.ways[0].density(fibers, v, anywhere), dtype=np.float64)
    stated = np.array(cells.ways[0].density(fibers, v, drawn), dtype=np.float64)
    drawn, anywhere = np.array(drawn).T, np.array(anywhere).T
    np.testing.assert_allclose(np.linalg.norm(drawn, axis=1), 1.0, atol=1e-5)
    # Those between two bins may be in either by rounding.
    assert (stated > 0).mean() > 0.9999
    # The mean of any function of direction is the same both ways: 1 first, for the norm.
    for function in (lambda d: np.ones(len(d)), lambda d: d[:, 1], lambda d: d[:, 2] ** 2):
        direct, weighted = function(drawn), function(anywhere) * weight
        error = np.hypot(direct.std(), weighted.std()) / np.sqrt(COUNT)
        assert abs(direct.mean() - weighted.mean()) < 4.5 * error + 1e-6


def test_without_faces_directions_go_straight_to_the_lamp(mono: ModuleType) -> None:
    from render.cells.arriving_light import ArrivingLight
    from render.cells.fiber_light import FiberLight
    from render.optics.pad_scene import pad_scene

    scene = scene_of_case("no face")
    phi = np.full((scene.lamp_count, 1), PHI)
    light = FiberLight(scene, phi, 0.0)
    arriving = ArrivingLight(pad_scene(scene, 0.0, False), light, scene.lamp_count)
    place, v = facets(scene, 0.0), on_facet(mono, 0, 0)
    v.n = mono.Normal3f(*place.site_normal[0].tolist())
    v.p = mono.Point3f(*place.site_position[2].tolist())
    pick, x, y = numbers(mono, 2)
    for fiber in range(scene.lamp_count):
        lamp = np.array(light.center_of(mono.UInt32(fiber))).ravel()
        span = lamp - place.site_position[2]
        straight = span / np.linalg.norm(span)
        drawn = arriving.sample(dr.full(mono.UInt32, fiber, COUNT), v, pick, x, y)
        angle = np.arccos(np.clip(np.array(drawn).T @ straight, -1, 1))
        # Bins are 0.1 rad wide, and so is the lamp from across a cube of a millimeter.
        assert (angle < 0.35).mean() > 0.95


def test_they_change_the_noise_of_a_smooth_bent_pad_and_not_its_light(
    mono: ModuleType, cells: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    from render.cells.guiding import FiberGlow

    levels, errors = [], []
    both = cells.ways, cells.shares
    for ways, shares in (both, ([FiberGlow(SCENE, BEND)], [mono.Float(1.0)])):
        monkeypatch.setattr(cells, "ways", ways)
        monkeypatch.setattr(cells, "shares", shares)
        run = MonteCarlo(cells, 1 << 14, 16, 1)
        run.sample(12)
        found = run.estimate()[..., 0]
        levels.append(found.sum(axis=1).mean())
        errors.append(found.sum(axis=1).std(ddof=1) / 4)
    assert abs(levels[0] - levels[1]) < 3.5 * np.hypot(*errors)
    assert errors[0] < 0.02 * levels[0]
    assert errors[0] < 0.7 * errors[1]
