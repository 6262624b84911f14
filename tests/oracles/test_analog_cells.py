"""Cells by analog photons: positions against the product's, brightness against quadrature."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from render.geometry import (
    facets,
    fiber_poses,
    flat_sites,
)
from render.scene import Scene, load_scene, unchecked
from tests.long import LONG
from tests.oracles.analog_cells import AnalogScene, analog_lamp, analog_pad, site_centers
from tests.oracles.kept_photons import PHI, analog
from tests.oracles.pads import content_of_case, scene_of_case
from tests.oracles.quadrature import facet_radiance, irradiance

pytestmark = pytest.mark.slow


def without_faces(albedo: float) -> Scene:
    """Return ``finger20`` with no rim, index 1 and few sites, so that its light is simple."""
    scene = load_scene("finger20")
    return unchecked(
        scene,
        {
            "diffuser": None,
            "pad": unchecked(scene.pad, {"index": 1.0}),
            "coating": unchecked(scene.coating, {"albedo": albedo}),
            "sites": unchecked(scene.sites, {"columns": 2, "rows": 1, "spacing": 6.0}),
        },
    )


@pytest.mark.parametrize("case", ["base beside a rim", "rows of their own", "below"])
def test_lamps_are_numbered_around_the_pad(case: str) -> None:
    scene = scene_of_case(case)
    poses = fiber_poses(scene, 0.0)
    for fiber in range(scene.lamp_count):
        lamp = analog_lamp(scene, fiber, np.pi / 2)
        np.testing.assert_allclose(lamp.center, poses.position[fiber], atol=1e-12)


def test_lamps_and_pyramids_are_where_the_geometry_has_them() -> None:
    scene = load_scene("finger20")
    poses, phi = fiber_poses(scene, 0.0), np.linspace(0.1, 3.0, scene.lamp_count)
    beams = poses.directions(phi)
    for fiber in range(scene.lamp_count):
        lamp = analog_lamp(scene, fiber, phi[fiber])
        np.testing.assert_allclose(lamp.center, poses.position[fiber], atol=1e-12)
        np.testing.assert_allclose(lamp.frame[:, 2], beams[fiber], atol=1e-12)
        np.testing.assert_allclose(lamp.frame.T @ lamp.frame, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(site_centers(scene), flat_sites(scene)[:, :2], atol=1e-12)
    pad, place = analog_pad(scene, indented=True), facets(scene, 0.0)
    np.testing.assert_allclose(pad.apex, place.corners[:, 0, 0], atol=1e-12)
    np.testing.assert_allclose(pad.normal, place.normal[0], atol=1e-12)


@pytest.mark.parametrize("phi", [0.2, 1.2, 2.6])
def test_listed_lamps_turn_as_the_geometry_has_them(phi: float) -> None:
    content = content_of_case("below")
    for listed in content["lamps"]:
        listed["turns"] = True
        listed["direction"]["value"] = [0.3, -0.2, 0.9]
    scene = Scene.model_validate(content)
    beams = fiber_poses(scene, 0.0).directions(np.full(scene.lamp_count, phi))
    for number in range(scene.lamp_count):
        found = analog_lamp(scene, number, phi).frame[:, 2]
        np.testing.assert_allclose(found, beams[number], atol=1e-12)


def test_a_cell_is_albedo_over_pi_times_the_irradiance_that_its_pixels_see() -> None:
    scene, fiber, phi = without_faces(1e-4), 2, 1.3
    analog = AnalogScene(scene, views=5000)
    cells = analog.cells(fiber, phi, 4_000_000)
    lamp = analog_lamp(scene, fiber, phi)
    truth = facet_radiance(scene, 0.0, lamp)
    # Facets that look at the lamp are in no other pyramid's shadow here.
    lit = truth > 0.3 * truth.max()
    assert lit.sum() > 5
    z = (cells.T - truth)[lit] / cells.se[lit]
    assert np.abs(z).max() < 4.5
    sums, expected = cells.replicates[:, lit].sum(axis=1), truth[lit].sum()
    assert stats.sem(sums) < 0.02 * expected
    assert sums.mean() == pytest.approx(expected, abs=3.5 * stats.sem(sums))


@pytest.mark.skipif(not LONG, reason="part of make validation-long")
def test_facets_in_the_tail_of_a_narrow_beam_have_what_quadrature_says() -> None:
    """There light changes by a factor of two across a quarter of a facet."""
    scene = scene_of_case("random 23")
    scene = unchecked(scene, {"coating": unchecked(scene.coating, {"albedo": 1e-4})})
    assert scene.fibers.sigma_v < np.radians(3.0)
    truth = facet_radiance(scene, 0.0, analog_lamp(scene, 0, PHI))
    cells = analog(scene, pressed=True).cells(0, PHI, 24_000_000)
    # The three facets that face the lamp at the site next to it, in no shadow.
    facing = truth > 0.1 * truth.max()
    facing[: 3 * scene.indenter.faces] = facing[4 * scene.indenter.faces :] = False
    assert facing.sum() == 3
    sums, expected = cells.replicates[:, facing].sum(axis=1), truth[facing].sum()
    assert stats.sem(sums) < 0.02 * expected
    assert sums.mean() == pytest.approx(expected, abs=3.5 * stats.sem(sums))


def test_a_site_that_no_pixel_shows_is_nan() -> None:
    scene = without_faces(0.5)
    camera = unchecked(scene.camera, {"y": 500.0})
    cells = AnalogScene(unchecked(scene, {"camera": camera}), indented=False).cells(0, 1, 16)
    assert np.isnan(cells.T).all()


def test_the_untouched_pad_has_a_cell_per_site_in_the_light_of_its_photons() -> None:
    scene, fiber, phi = without_faces(1e-4), 2, 1.3
    cells = AnalogScene(scene, indented=False, views=5000).cells(fiber, phi, 1_000_000)
    step = (np.arange(40) + 0.5) / 20 - 1
    x, y = (0.7 * scene.indenter.radius * a for a in np.meshgrid(step, step))
    spot = np.hypot(x, y) < 0.7 * scene.indenter.radius
    lamp = analog_lamp(scene, fiber, phi)
    for site, center in enumerate(flat_sites(scene)):
        points = center + np.stack([x[spot], y[spot], np.zeros(spot.sum())], axis=-1)
        expected = 1e-4 / np.pi * irradiance(points, np.array([0.0, 0.0, -1.0]), lamp).mean()
        assert cells.T[site] == pytest.approx(expected, abs=4.5 * cells.se[site] + 0.01 * expected)
