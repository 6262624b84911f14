"""Analog photons among triangles: against the box of planes, and against quadrature when bent."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from render.geometry import fresnel
from render.preview.bonded import with_bonded_window
from render.scene import Scene, unchecked
from tests.long import LONG
from tests.oracles.analog_cells import AnalogScene, analog_lamp
from tests.oracles.analog_tracer import BACK, COATING, ENDS, MEDIUM, MICROFACETS
from tests.oracles.mesh_cells import BentScene, mesh_bin_areas, mesh_pad
from tests.oracles.mesh_tracer import (
    AIR,
    COATED,
    LEAKED,
    trace_photons_on_mesh,
    trace_views_on_mesh,
)
from tests.oracles.pads import scene_of_case
from tests.oracles.quadrature import facet_radiance

pytestmark = pytest.mark.slow

PHI = 1.2


def without_faces(albedo: float) -> Scene:
    """Return a clear pad of index 1 and little albedo, so that its light is direct."""
    scene = scene_of_case("no face")
    return unchecked(scene, {"coating": unchecked(scene.coating, {"albedo": albedo})})


def test_lamps_are_those_of_the_flat_pad() -> None:
    scene = scene_of_case("rim")
    for fiber in range(scene.lamp_count):
        bent, flat = BentScene(scene, 0.0).lamp(fiber, PHI), analog_lamp(scene, fiber, PHI)
        # The frames may differ by a turn about the beam, which no profile knows.
        ours, theirs = (lamp._replace(frame=lamp.frame[:, 2]) for lamp in (bent, flat))
        for one, other in zip(ours, theirs, strict=True):
            np.testing.assert_allclose(one, other, atol=1e-12)


@pytest.mark.parametrize("case", ["smooth", "rim rough 0.1", "lobe rough 0.1"])
def test_a_flat_pad_of_triangles_is_as_bright_as_the_box(case: str) -> None:
    scene, photons = scene_of_case(case), 160_000
    bent = BentScene(scene, 0.0, views=2000).cells(0, PHI, photons)
    flat = AnalogScene(scene, views=2000).cells(0, PHI, 4 * photons)
    sums, expected = bent.replicates.sum(axis=1), flat.replicates.sum(axis=1)
    error = np.hypot(stats.sem(sums), stats.sem(expected))
    assert error < 0.05 * expected.mean()
    assert sums.mean() == pytest.approx(expected.mean(), abs=4 * error)
    well = flat.se < 0.1 * flat.T
    z = (bent.T - flat.T)[well] / np.hypot(bent.se, flat.se)[well]
    assert well.sum() > 10
    assert np.sqrt((z**2).mean()) < 1.6


def test_a_window_of_the_pads_index_is_as_bright_as_a_thicker_pad() -> None:
    scene, photons = scene_of_case("window like the pad"), 160_000
    window, lamp = BentScene(scene, 0.0, views=2000), 0
    whole = AnalogScene(with_bonded_window(scene), views=2000)
    found, expected = (
        pad.cells(lamp, PHI, photons).replicates.sum(axis=1) for pad in (window, whole)
    )
    error = np.hypot(stats.sem(found), stats.sem(expected))
    assert error < 0.05 * expected.mean()
    assert found.mean() == pytest.approx(expected.mean(), abs=4 * error)


def test_a_smooth_plate_passes_what_fresnel_says_and_loses_nothing() -> None:
    scene = scene_of_case("window")
    pad = BentScene(scene, 0.0).pad._replace(albedo=0.0)
    origin, aim = np.array([1.0, 2.0, -20.0]), np.array([0.35, 0.1, 1.0])
    aim /= np.linalg.norm(aim)
    _, _, weights = trace_views_on_mesh(pad, origin, np.tile(aim, (60_000, 1)), 5)
    # Two faces that light goes to and fro between: (1 - a)(1 - b) / (1 - a b).
    cos_air = aim[2]
    cos_plate, cos_pad = (np.sqrt(1 - (1 - cos_air**2) / n**2) for n in (1.49, 1.41))
    a = fresnel(np.array([cos_air]), 1.49)[0][0]
    b = fresnel(np.array([cos_plate]), 1.41 / 1.49)[0][0]
    assert cos_pad < 1.0
    passed = (1 - a) * (1 - b) / (1 - a * b)
    assert weights.mean() == pytest.approx(passed, abs=4 * np.sqrt(passed * (1 - passed) / 60_000))


def test_no_power_is_lost_in_a_bent_pad_and_none_leaks_between_its_triangles() -> None:
    scene = scene_of_case("rim rough 0.1")
    bent = BentScene(scene, np.pi / 2)
    _, ends = trace_photons_on_mesh(bent.pad, bent.lamp(0, PHI), AIR, 100_000, 3, len(bent.area))
    assert len(ends) == ENDS + 1
    assert ends.sum() == pytest.approx(1.0, abs=1e-9)
    assert ends[LEAKED] == 0.0
    # What leaves the rim's upper face may cross the arc and meet the coating from behind.
    assert 0.0 < ends[BACK] < 0.01
    assert abs(ends[MICROFACETS]) < 0.05
    assert ends[MEDIUM] > 0.005
    assert ends[COATING] > 0.05


@pytest.mark.parametrize("bend", [0.0, 1.0])
def test_bins_of_the_coating_have_its_area(bend: float) -> None:
    pad = mesh_pad(scene_of_case("smooth"), bend, indented=True)
    coated = pad.kind == COATED
    area = 0.5 * np.linalg.norm(np.cross(pad.first, pad.second), axis=-1)[coated]
    assert mesh_bin_areas(pad).sum() == pytest.approx(area.sum(), rel=1e-4)


def test_a_bent_pads_facets_are_lit_by_their_form_factors() -> None:
    scene, bend = without_faces(1e-4), 0.8
    bent = BentScene(scene, bend, views=2000)
    lamp = bent.lamp(0, PHI)
    truth = facet_radiance(scene, bend, lamp)
    # Facets that look at the lamp lie in no other pyramid's shadow here.
    lit = truth > 0.3 * truth.max()
    assert lit.sum() > 3
    cells = bent.cells(0, PHI, 1_000_000)
    sums, expected = cells.replicates[:, lit].sum(axis=1), truth[lit].sum()
    assert stats.sem(sums) < 0.03 * expected
    assert sums.mean() == pytest.approx(expected, abs=3.5 * stats.sem(sums))
    assert np.abs((cells.T - truth)[lit] / cells.se[lit]).max() < 4.5


@pytest.mark.skipif(not LONG, reason="part of make validation-long")
def test_facets_of_a_bent_pad_in_the_tail_of_a_narrow_beam_have_what_quadrature_says() -> None:
    wide, bend, ahead = without_faces(1e-4), 0.8, np.pi / 2
    narrow = unchecked(wide.fibers, {"sigma_v": np.radians(3.0), "tilt": 0.0})
    scene = unchecked(wide, {"fibers": narrow})
    bent = BentScene(scene, bend, views=2000)
    truth = facet_radiance(scene, bend, bent.lamp(0, ahead))
    # Three in the beam, three beside it that have 4 to 12 % of the brightest.
    lit = truth > 0.04 * truth.max()
    assert lit.sum() >= 6
    assert (truth[lit] < 0.15 * truth.max()).sum() >= 3
    cells = bent.cells(0, ahead, 8_000_000)
    for part in (lit, lit & (truth < 0.15 * truth.max())):
        sums, expected = cells.replicates[:, part].sum(axis=1), truth[part].sum()
        assert stats.sem(sums) < 0.05 * expected
        assert sums.mean() == pytest.approx(expected, abs=3.5 * stats.sem(sums))
