"""Radiosity: limits, bounds and symmetry."""

import numpy as np
import pytest

from render.preview.radiosity import Radiosity, solve_radiosity
from render.preview.shading_points import ShadingPoints, shading_points
from render.scene import Scene, load_scene, unchecked
from tests.oracles.pads import scene_of_case


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("finger20")


@pytest.fixture(scope="module")
def points(scene: Scene) -> ShadingPoints:
    return shading_points(scene)


def solved(scene: Scene, points: ShadingPoints, albedo: float, edge: float) -> Radiosity:
    coating = unchecked(scene.coating, {"albedo": albedo})
    return solve_radiosity(unchecked(scene, {"coating": coating}), points, 0.0, edge)


def test_patches_cover_the_coating_and_the_lit_edges(scene: Scene, points: ShadingPoints) -> None:
    area = points.size.prod(axis=1)
    pad = scene.pad
    assert area[points.first_patch : points.first_edge].sum() == pytest.approx(
        pad.width * pad.length
    )
    assert area[points.first_edge :].sum() == pytest.approx(
        pad.thickness * (2 * pad.length + pad.width)
    )
    np.testing.assert_allclose(np.linalg.norm(points.normal, axis=1), 1.0)


def test_without_diffuser_no_edge_reflects(scene: Scene) -> None:
    assert shading_points(unchecked(scene, {"diffuser": None})).edge.size == 0


def test_a_large_pad_keeps_a_bounded_number_of_patches(scene: Scene) -> None:
    pad = unchecked(scene.pad, {"width": 900.0, "length": 1000.0})
    assert len(shading_points(unchecked(scene, {"pad": pad})).position) < 1000


def test_black_faces_add_nothing(scene: Scene, points: ShadingPoints) -> None:
    black = solved(scene, points, 0.0, 0.0)
    np.testing.assert_array_equal(black.added(np.ones((1, len(points.position)))), 0.0)


def test_no_point_receives_more_than_its_whole_sky(scene: Scene, points: ShadingPoints) -> None:
    # A little albedo: radiosity is then albedo, and what is added albedo times the seen part.
    once = solved(scene, points, 1e-6, 1e-6)
    seen = once.indirect.sum(axis=1) / 1e-6
    sites = slice(points.sites * points.facets, points.first_patch)
    assert (seen > 0).all()
    assert (seen[sites] < 1.0).all()
    # The lower face lets steep light out and reflects the rest: about half of a site's sky.
    np.testing.assert_allclose(seen[sites], 0.5, atol=0.1)


def test_bright_faces_multiply_light_but_stay_finite(scene: Scene, points: ShadingPoints) -> None:
    light = np.ones((1, len(points.position)))
    added = [solved(scene, points, a, a).added(light).mean() for a in (0.2, 0.6, 1.0)]
    assert added[0] < added[1] < added[2] < 10.0


def test_a_facet_sees_the_coating_around_it(scene: Scene, points: ShadingPoints) -> None:
    light = solved(scene, points, 0.6, 0.0)
    expected = 0.5 * (1 - np.cos(scene.indenter.slope)) * 0.6
    np.testing.assert_allclose(light.below(np.array([[2.0]]))[0], np.full(10, 2 * expected))


def test_radiosity_is_mirror_symmetric(scene: Scene, points: ShadingPoints) -> None:
    added = solved(scene, points, 0.6, 0.5).added(np.ones((1, len(points.position))))[0]
    first = points.sites * points.facets
    sites = added[first : points.first_patch].reshape(scene.sites.rows, scene.sites.columns)
    np.testing.assert_allclose(sites, sites[:, ::-1], rtol=1e-9)


def test_a_dome_in_air_sees_itself_as_a_sphere_does() -> None:
    # Between any two places of a sphere the coupling is area / (4 pi R^2); index 1 has no mirrors.
    dome = scene_of_case("dome")
    air = unchecked(dome, {"pad": unchecked(dome.pad, {"index": 1.0})})
    points = shading_points(air)
    added = solve_radiosity(air, points, 0.0, 0.0).added(np.ones((1, len(points.position))))[0]
    x, y = (np.linspace(-0.5, 0.5, 401)[1:] - 0.5 / 400 for _ in range(2))
    x, y = np.meshgrid(x * air.pad.width, y * air.pad.length)
    area = (30.0 / np.sqrt(900.0 - x**2 - y**2)).mean() * air.pad.width * air.pad.length
    part = air.coating.albedo * area / (4 * np.pi * 900.0)
    on_skin = slice(points.sites * points.facets, None)
    np.testing.assert_allclose(added[on_skin], part / (1 - part), rtol=2e-3)
