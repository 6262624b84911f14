"""Light that lamps send straight to the pad: closed forms, analog photons, and itself."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from render.geometry import declared_sites, fiber_poses
from render.preview.converged import Effort, block, transport, transport_at
from render.preview.converged.arrivals import Arrivals, arrivals, flown, receivers_at
from render.preview.converged.block import bent_block, patch_areas
from render.preview.converged.gathering import site_points
from render.preview.converged.launching import launched
from render.preview.diffuser.cache import fiber_ends
from render.preview.diffuser.emission import radiance_of_nodes
from render.preview.facet_blur import RINGS, ring_count
from render.progress import Clock
from render.scene import Scene, unchecked
from tests.oracles.analog_cells import AnalogScene
from tests.oracles.kept_photons import PHI, photons_kept
from tests.oracles.mesh_cells import BentScene
from tests.oracles.pads import scene_of_case
from tests.oracles.random_scenes import random_scene
from tests.small_scenes import small_scene

AHEAD = np.array([np.pi / 2])
FLAT = {"angles": {"value": [0.0], "unit": "deg", "source": "flat"}}


def clear_pad(**pad: float) -> Scene:
    """Return a flat pad without a diffuser, with values of ``pad`` in place of its own."""
    scene = unchecked(small_scene(bending=FLAT), {"diffuser": None})
    return unchecked(scene, {"pad": unchecked(scene.pad, pad)})


def from_block(scene: Scene, points: np.ndarray) -> np.ndarray:
    return points * [1.0, 1.0, -1.0] + [0.0, scene.camera.pivot, scene.pad.thickness]


def arrived(scene: Scene, lamp: int, photons: int, bend: float = 0.0) -> Arrivals:
    blocks = bent_block(scene, bend, pressed=False), bent_block(scene, bend, pressed=True)
    receivers = receivers_at(scene, bend)
    brought = flown(scene, bend, lamp, AHEAD, *blocks, receivers, photons, range(photons))
    return arrivals(scene, brought).whole


def inverse_square(scene: Scene, lamp: int, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the way from a lamp to level ``places`` ``(..., 3)``, and irradiance over pi there."""
    poses, end = fiber_poses(scene, 0.0), fiber_ends(scene)[lamp]
    to = places - poses.position[lamp]
    distance = np.linalg.norm(to, axis=-1)
    beam = poses.directions(np.full(scene.lamp_count, np.pi / 2))[lamp]
    angle = np.arccos(to @ beam / distance)
    # Light gets in at the edge alone; the lamp is a disk that a far spot sees foreshortened.
    intensity = end.peak_intensity * end.radiance(angle) * np.cos(angle)
    return to, intensity * to[..., 2] / distance / distance**2 / np.pi


@pytest.mark.slow
def test_without_refraction_a_spot_gets_the_inverse_square_of_its_distance() -> None:
    scene = clear_pad(index=1.0)
    lamp = 1
    flat = declared_sites(scene)
    spots = np.column_stack([flat[:, :2], np.full(len(flat), scene.pad.thickness)])
    _, expected = inverse_square(scene, lamp, spots)
    found = arrived(scene, lamp, 600_000).spots[:, 0]
    bright = expected > 0.2 * expected.max()
    assert bright.sum() >= 2
    np.testing.assert_allclose(found[bright], expected[bright], rtol=0.08)


@pytest.mark.slow
def test_without_refraction_rings_before_facets_get_the_inverse_square_of_their_distance() -> None:
    scene = clear_pad(index=1.0, roughness=0.3, thickness=6.0)
    rings, faces = ring_count(scene), scene.indenter.faces
    assert rings == len(RINGS) - 1
    lamp = 1
    middle = scene.indenter.radius * 0.5 * (np.array(RINGS[:-1]) + np.array(RINGS[1:]))
    azimuth = 2 * np.pi * np.arange(faces) / faces - scene.sites.turns[:, None]
    around = np.stack([np.sin(azimuth), np.cos(azimuth)], axis=-1)
    offset = middle[:, None, None] * around[:, None]
    places = declared_sites(scene)[:, None, None, :2] + offset
    level = np.full((*places.shape[:-1], 1), scene.pad.thickness)
    to, expected = inverse_square(scene, lamp, np.concatenate([places, level], axis=-1))
    distance = np.linalg.norm(to, axis=-1)
    found = arrived(scene, lamp, 600_000).rings[..., 0].reshape(expected.shape)
    length = np.linalg.norm(offset, axis=-1)
    facing = np.sum(-to[..., :2] * offset, axis=-1) > 0.5 * distance * length
    bright = facing & (expected > 0.2 * expected.max())
    assert all(bright[:, ring].any() for ring in range(rings))
    np.testing.assert_allclose(found[bright], expected[bright], rtol=0.12)
    # Behind the pyramid is its shadow, the less the farther.
    behind = np.sum(to[..., :2] * offset, axis=-1) > 0.8 * distance * length
    left = [np.mean((found / expected)[:, ring][behind[:, ring]]) for ring in range(rings)]
    assert left[0] < 0.7
    assert (np.diff(left) > 0.0).all()
    assert left[-1] > 0.9


def test_rings_that_leave_the_pad_end_at_its_side() -> None:
    scene = clear_pad(roughness=0.3, thickness=6.0)
    half = 0.5 * np.array([scene.pad.width, scene.pad.length])
    away = half[0] - 1.5 * scene.indenter.radius - declared_sites(scene)[:, 0].max()
    moved = unchecked(scene.sites, {"centre_x": scene.sites.centre_x + away})
    scene = unchecked(scene, {"sites": moved})
    corners = from_block(scene, receivers_at(scene, 0.0).corners)[..., :2]
    near = int(np.argmax(declared_sites(scene)[:, 0]))
    starts = [
        from_block(scene, site_points(scene, 0.0, near, facet, 64, ring=len(RINGS) - 2).points)
        for facet in range(scene.indenter.faces)
    ]
    for places in (corners.reshape(-1, 2), np.concatenate(starts)[:, :2]):
        assert np.isclose(places[:, 0].max(), half[0], rtol=1e-3)
        assert (np.abs(places) < half).all()
    lit = arrived(scene, 1, 20_000).rings
    assert np.isfinite(lit).all()
    assert lit.reshape(len(scene.sites.turns), ring_count(scene), -1).sum(axis=(0, 2)).min() > 0.0


def test_without_refraction_the_coating_gets_what_a_lamp_sends_into_its_solid_angle() -> None:
    scene = clear_pad(index=1.0, roughness=0.0)
    lamp = 1
    poses, end = fiber_poses(scene, 0.0), fiber_ends(scene)[lamp]
    beam = poses.directions(np.full(scene.lamp_count, np.pi / 2))[lamp]
    across = np.cross(beam, [0.0, 0.0, 1.0])
    up = np.cross(across, beam)
    # Rings of the lamp's disk that hold as much light each, and a fine grid over the coating.
    ring, turn = np.meshgrid(np.sqrt((np.arange(4) + 0.5) / 4), np.arange(8) * np.pi / 4)
    disk = (
        end.diameter
        / 2
        * (
            (ring * np.cos(turn)).reshape(-1, 1) * across
            + (ring * np.sin(turn)).reshape(-1, 1) * up
        )
    )
    pad, count = scene.pad, 400
    x = ((np.arange(count) + 0.5) / count - 0.5) * pad.width
    y = ((np.arange(count) + 0.5) / count - 0.5) * pad.length
    coating = np.stack(np.meshgrid(x, y, [pad.thickness], indexing="ij"), axis=-1).reshape(-1, 3)
    expected = 0.0
    for point in poses.position[lamp] + disk:
        to = coating - point
        distance = np.linalg.norm(to, axis=1)
        cosine = to @ beam / distance
        seen = np.where(cosine > 0, cosine * end.radiance(np.arccos(cosine)), 0.0)
        received = end.peak_intensity * seen * to[:, 2] / distance**3
        expected += received.mean() * pad.width * pad.length / len(disk)
    patches = arrived(scene, lamp, 200_000).patches[:, 0]
    found = np.pi * (patches * patch_areas(scene)).sum()
    assert found == pytest.approx(expected, rel=0.02)


@pytest.mark.slow
def test_cells_of_a_clear_rough_pad_are_those_of_analog_photons() -> None:
    scene = clear_pad(roughness=0.15)
    found = transport_at(scene, 0.0, AHEAD, Effort(paths=2048, arrivals=1_200_000), quiet())
    photons = AnalogScene(scene, True)
    for lamp in (0, 4):
        batches = photons.cells(lamp, np.pi / 2, 200_000).replicates
        truth, se = batches.mean(axis=0).ravel(), stats.sem(batches, axis=0).ravel()
        cells = found.cells[lamp, 0, :, :-1].ravel()
        noise = np.sqrt(se**2 + found.grain[lamp, 0] * truth)
        # Two percent more for light that is not quite alike within a pyramid.
        spread = float(stats.sem(batches.sum(axis=1)))
        assert cells.sum() == pytest.approx(truth.sum(), abs=3 * spread + 0.02 * truth.sum())
        error = (cells - truth) / np.hypot(noise, 0.02 * truth)
        assert np.sqrt(np.mean(error**2)) < 1.5


@pytest.mark.parametrize(
    "case",
    [
        pytest.param("random 13", id="light that goes down from lamps near the skin"),
        pytest.param("cast in index 1.7", id="light that circles, past pyramids that would end it"),
        pytest.param("narrow 6 deg", id="beams that are narrower than pyramids"),
    ],
)
def test_facets_have_the_light_of_analog_photons(case: str) -> None:
    scene, effort = scene_of_case(case), Effort(paths=1024, arrivals=800_000)
    found = transport_at(scene, 0.0, np.array([PHI]), effort, quiet()).cells[:, 0, :, :-1]
    truth = photons_kept(case, pressed=True).sum(axis=-1)
    light = found.reshape(scene.lamp_count, -1).sum(axis=-1)
    assert light == pytest.approx(truth.mean(axis=0), rel=0.06)


@pytest.mark.slow
def test_light_that_skims_a_bent_coating_meets_the_pyramids_as_photons_do() -> None:
    # The coating bends away from the light: half of what gets to facets goes up from it again.
    scene, bend = random_scene(71), np.pi / 3
    found = transport_at(scene, bend, AHEAD, Effort(paths=2048, arrivals=3_000_000), quiet())
    photons = BentScene(scene, bend)
    for lamp in (0, 4):
        batches = photons.cells(lamp, np.pi / 2, 60_000).replicates
        seen = np.isfinite(batches).all(axis=0)
        whole = batches[:, seen].sum(axis=1)
        cells = found.cells[lamp, 0, :, :-1].ravel()[seen].sum()
        # Six percent more for light that is not alike within a pyramid of a third of the pad.
        allowed = 2 * float(stats.sem(whole)) + 0.06 * whole.mean()
        assert cells == pytest.approx(whole.mean(), abs=allowed)


def test_the_grain_is_the_variance_of_a_cell_over_the_cell() -> None:
    scene = clear_pad()
    blocks = bent_block(scene, 0.0, pressed=False), bent_block(scene, 0.0, pressed=True)
    receivers, photons = receivers_at(scene, 0.0), 20_000
    runs = [
        arrivals(
            scene, flown(scene, 0.0, 1, AHEAD, *blocks, receivers, photons, range(photons), seed)
        ).whole
        for seed in range(24)
    ]
    facets = np.array([run.facets[..., 0] for run in runs])
    variance = facets.var(axis=0, ddof=1).sum()
    assert runs[0].grain[0] * facets.mean(axis=0).sum() == pytest.approx(variance, rel=0.5)


def test_weights_of_launched_rays_are_the_radiance_of_every_node() -> None:
    scene, phi = clear_pad(), np.array([0.3, 1.2, 2.9])
    origin, direction, weights = launched(scene, 0.0, 3, phi, range(2000), 5)
    poses, end = fiber_poses(scene, 0.0), fiber_ends(scene)[3]
    frame = np.stack([poses.along[3], poses.inward[3], poses.up[3]])
    offset = (origin - poses.position[3]) @ frame.T
    expected = radiance_of_nodes(end, end.directions(phi), offset, direction @ frame.T)
    expected /= expected.mean(axis=1, keepdims=True) * 2000
    np.testing.assert_allclose(weights, expected, atol=1e-6 * weights.max())
    np.testing.assert_allclose(weights.sum(axis=0), 1.0, rtol=0.02)


def test_a_slightly_bent_pad_gets_what_the_flat_one_gets() -> None:
    scene = clear_pad()
    flat, bent = (arrived(scene, 1, 50_000, bend) for bend in (0.0, 1e-7))
    np.testing.assert_allclose(bent.patches, flat.patches, atol=0.02 * flat.patches.max())


@pytest.mark.slow
def test_what_belongs_to_the_exit_field_and_what_flies_is_all_light(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scene = small_scene(bending=FLAT)
    layer = unchecked(scene.diffuser, {"thickness": 0.75})  # type: ignore[union-attr]
    thin = unchecked(scene, {"diffuser": layer})
    effort, phi = Effort(photons=40_000, paths=256, arrivals=1_200_000), np.array([1.0, 2.0])
    parted = transport_at(thin, 0.0, phi, effort, quiet())
    assert (parted.grain > 0.0).all()
    for module in (block, transport):
        monkeypatch.setattr(module, "wide_from", lambda scene: 1_000_000)
    flown = transport_at(thin, 0.0, phi, effort, quiet())
    assert parted.cells.shape == flown.cells.shape == (8, 2, 6, 7)
    by_lamp, expected = (found.cells.sum(axis=(1, 2, 3)) for found in (parted, flown))
    np.testing.assert_allclose(by_lamp, expected, rtol=0.12)
    assert by_lamp.sum() == pytest.approx(expected.sum(), rel=0.04)


def quiet() -> Clock:
    return Clock(1, None)


def test_batches_of_photons_bring_together_what_all_of_them_bring() -> None:
    scene = clear_pad()
    blocks = bent_block(scene, 0.0, pressed=False), bent_block(scene, 0.0, pressed=True)
    receivers, photons = receivers_at(scene, 0.0), 5_000
    parts = [range(0, 1_700), range(1_700, 3_100), range(3_100, photons)]
    whole, *some = (
        flown(scene, 0.0, 1, AHEAD, *blocks, receivers, photons, numbers)
        for numbers in (range(photons), *parts)
    )
    together = some[0] + some[1] + some[2]
    for name in whole._fields:
        assert getattr(together, name) == pytest.approx(getattr(whole, name), rel=1e-12), name
    assert whole.first_received.sum() == pytest.approx(0.5 * whole.received.sum(), rel=0.1)
