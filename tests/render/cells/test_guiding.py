"""Guided directions follow the density that they state."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import drjit as dr
import numpy as np
import pytest

from render.cells.guiding import FiberGlow
from render.geometry import facets
from render.reference import pad_cells
from render.scene import Scene, load_scene
from tests.oracles.pads import scene_of_case

COUNT = 1 << 18


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("finger20")


def facet_points(scene: Scene, bend: float) -> np.ndarray:
    return np.asarray(facets(scene, bend).centroid).reshape(-1, 3)


def lanes(mono: ModuleType, points: np.ndarray) -> Any:
    from render.paths.vertex import empty_vertex

    v = empty_vertex()
    v.p = mono.Point3f(np.ascontiguousarray(points.T).astype(np.float32))
    return v


@pytest.mark.parametrize("bend", [0.0, np.pi / 2])
@pytest.mark.parametrize("fiber", [2, 9])
def test_the_density_is_that_of_the_sampled_directions(
    mono: ModuleType, scene: Scene, fiber: int, bend: float
) -> None:
    glow = FiberGlow(scene, bend)
    a = lanes(mono, np.repeat(facet_points(scene, bend)[70:71], COUNT, axis=0))
    fibers = mono.UInt32(np.full(COUNT, fiber, dtype=np.uint32))
    rng = np.random.default_rng(1)
    x, y = (mono.Float(rng.random(COUNT).astype(np.float32)) for _ in range(2))
    drawn = glow.sample(fibers, a, x, x, y)
    anywhere = mono.warp.square_to_uniform_sphere(mono.Point2f(x, y))
    density = glow.density(fibers, a, anywhere)
    dr.eval(drawn, anywhere, density)
    drawn, anywhere = np.array(drawn).T, np.array(anywhere).T
    weight = 4 * np.pi * np.array(density, dtype=np.float64)
    assert np.isfinite(weight).all()
    # The mean of any function of direction is the same both ways: 1 first, for the norm.
    for function in (lambda d: np.ones(len(d)), lambda d: d[:, 1], lambda d: d[:, 2] ** 2):
        direct, weighted = function(drawn), function(anywhere) * weight
        error = np.hypot(direct.std(), weighted.std()) / np.sqrt(COUNT)
        assert abs(direct.mean() - weighted.mean()) < 4 * error


@pytest.mark.parametrize("bend", [0.0, np.pi / 2, np.pi])
def test_every_facet_aims_at_every_fiber_with_a_positive_finite_density(
    mono: ModuleType, scene: Scene, bend: float
) -> None:
    points = facet_points(scene, bend)
    count = scene.lamp_count
    a = lanes(mono, np.repeat(points, count, axis=0))
    fibers = mono.UInt32(np.tile(np.arange(count, dtype=np.uint32), len(points)))
    rng = np.random.default_rng(2)
    x, y = (mono.Float(rng.random(len(points) * count).astype(np.float32)) for _ in range(2))
    glow = FiberGlow(scene, bend)
    directions = glow.sample(fibers, a, x, x, y)
    density = np.array(glow.density(fibers, a, directions))
    assert np.isfinite(np.array(directions)).all()
    assert np.isfinite(density).all()
    # Aim points in the last thousandth of the wall's height may fall off it by rounding.
    assert (density > 0).mean() > 0.999


def test_the_density_of_a_mixture_is_that_of_its_directions(mono: ModuleType) -> None:
    """Behind a rim of one mean free path both the glow and what photons say are drawn from."""
    from render.paths.vertex import empty_vertex

    scene = scene_of_case("thin rim")
    phi = np.full((scene.lamp_count, 1), 1.2)
    cells = pad_cells(scene, phi, 0.0, True, sampler="monte-carlo")
    guiding = cells.guiding(dr.full(mono.UInt32, 0, COUNT))
    assert len(guiding.ways) == 2
    place, v = facets(scene, 0.0), empty_vertex()
    v.p = mono.Point3f(*place.centroid[1, 2].tolist())
    v.n = mono.Normal3f(*place.normal[1, 2].tolist())
    rng = np.random.default_rng(5)
    pick, x, y = (mono.Float(rng.random(COUNT).astype(np.float32)) for _ in range(3))
    # All of these numbers select a guided direction.
    drawn = guiding.sample(v, pick * guiding.fraction, x, y)
    anywhere = mono.warp.square_to_uniform_sphere(mono.Point2f(x, y))
    nothing = dr.zeros(mono.Float, COUNT)
    density = guiding.mixture_pdf(v, anywhere, nothing) / guiding.fraction
    dr.eval(drawn, anywhere, density)
    drawn, anywhere = np.array(drawn).T, np.array(anywhere).T
    weight = 4 * np.pi * np.array(density, dtype=np.float64)
    for function in (lambda d: np.ones(len(d)), lambda d: d[:, 1], lambda d: d[:, 2] ** 2):
        direct, weighted = function(drawn), function(anywhere) * weight
        error = np.hypot(direct.std(), weighted.std()) / np.sqrt(COUNT)
        assert abs(direct.mean() - weighted.mean()) < 4 * error
