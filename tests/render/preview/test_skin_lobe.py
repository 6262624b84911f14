"""Previews of a skin with a lobe: against analog photons, and what does not depend on the lobe."""

from __future__ import annotations

import numpy as np
import pytest

from render.geometry import counted_sites, facet_masks
from render.preview import Preview
from render.preview.converged import Effort, transport_at
from render.preview.facet_blur import lines_of_sight
from render.progress import Clock
from render.scene import Scene, unchecked
from tests.oracles.analog_cells import AnalogScene
from tests.oracles.pads import scene_of_case

PHI = 1.2


def photons(scene: Scene, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return radiance of all facets of both lamps ``(cell,)`` and its standard error."""
    analog = AnalogScene(scene, True)
    cells = [analog.cells(lamp, PHI, count) for lamp in range(scene.lamp_count)]
    return np.concatenate([each.T for each in cells]), np.concatenate([each.se for each in cells])


def test_lines_of_sight_lead_from_the_camera_to_facets_and_coating() -> None:
    scene = scene_of_case("lobe")
    sights = lines_of_sight(scene, 0.0)
    faces = scene.indenter.faces
    assert sights.shape[:2] == (len(counted_sites(scene)), faces + 2)
    np.testing.assert_allclose(np.linalg.norm(sights, axis=-1), 1.0)
    # A smooth face: by Snell's law from the pinhole 20 mm below to a spot 4.5 mm above it.
    x, y = scene.sites.places[0]
    reach, low, high = np.hypot(x, y), 0.0, 1.0
    for _ in range(60):
        sine = 0.5 * (low + high)
        inside = sine / scene.pad.index
        met = 20 * sine / np.sqrt(1 - sine**2) + 4.5 * inside / np.sqrt(1 - inside**2)
        low, high = (sine, high) if met < reach else (low, sine)
    spot = sights[0, -1].mean(axis=0)
    np.testing.assert_allclose(spot[:2], inside * np.array([x, y]) / reach, atol=3e-3)


@pytest.mark.slow
@pytest.mark.parametrize("case", ["lobe rough 0.1", "sharp lobe rough 0.1"])
def test_the_converged_preview_has_the_light_of_analog_photons(case: str) -> None:
    scene = scene_of_case(case)
    effort = Effort(photons=1000, paths=2048, arrivals=1_200_000)
    found = transport_at(scene, 0.0, np.array([PHI]), effort, Clock(1, None))
    truth, se = photons(scene, 800_000)
    cells = found.cells[:, 0, :, :-1].ravel()
    grain = np.repeat(found.grain[:, 0], truth.size // scene.lamp_count)
    noise = np.sqrt(se**2 + grain * truth)
    assert cells.sum() == pytest.approx(truth.sum(), rel=0.05)
    # Four percent more for light that is not quite alike within a pyramid: lobes are steeper.
    assert np.sqrt(np.mean(((cells - truth) / np.hypot(noise, 0.04 * truth)) ** 2)) < 1.5


@pytest.mark.slow
@pytest.mark.parametrize(
    ("case", "off"), [("lobe rough 0.1", 0.08), ("sharp lobe rough 0.1", 0.17)]
)
def test_the_preview_as_drawn_is_near_the_light_of_analog_photons(case: str, off: float) -> None:
    scene = scene_of_case(case)
    with Preview(scene) as preview:
        drawn = preview.transport(np.full((2, 1), PHI), np.zeros(1))[0].ravel()
    truth, _ = photons(scene, 800_000)
    bright = truth > 0.1 * truth.mean()
    assert drawn.sum() == pytest.approx(truth.sum(), rel=0.07)
    assert np.median(np.abs(drawn / truth - 1)[bright]) < off
    # Taken for diffuse it is far away.
    lambert = unchecked(
        scene.coating, {"albedo": scene.coating.reflectance, "specular": None, "roughness": None}
    )
    with Preview(unchecked(scene, {"coating": lambert})) as preview:
        plain = preview.transport(np.full((2, 1), PHI), np.zeros(1))[0].ravel()
    assert np.median(np.abs(plain / truth - 1)[bright]) > 1.5 * off


@pytest.mark.slow
def test_a_picture_shows_the_brightness_of_the_cells_it_is_made_of() -> None:
    """Untouched spots of a smooth pad, whose pixels see nothing else."""
    scene = scene_of_case("sharp lobe")
    power = np.zeros((2, 3))
    power[0] = 1.0
    with Preview(scene) as preview:
        spots = preview.transport(np.full((2, 1), PHI), np.zeros(1))[1][0, 0, 0]
        size = scene.camera.columns, scene.camera.rows
        picture = preview.picture(np.full(2, PHI), power, 0.0, *size, indented=False)
    masks = facet_masks(scene, 0.0)
    # As one looks at the skin from outside: the mirror image of what the camera records.
    image = picture[:, ::-1, 0].ravel()
    seen = [image[masks.of(site, masks.facets)].mean() for site in counted_sites(scene)]
    np.testing.assert_allclose(seen, spots, rtol=0.03)
