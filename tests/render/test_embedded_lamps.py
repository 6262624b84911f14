"""Light of a lamp in the silicone by closed forms, at all levels.

In a clear flat pad with black edges, a dark skin gets what comes straight and what its smooth lower
face reflects: two integrals over the lamp's disk. Without a face there is but the first.
"""

from __future__ import annotations

from types import ModuleType

import numpy as np
import pytest

from render.geometry import camera_origin, facets
from render.preview import Preview
from render.preview.converged import Effort, transport_at
from render.progress import Clock
from render.reference import render_transport
from render.scene import Scene
from tests.oracles.analog_cells import analog_lamp
from tests.oracles.analog_tracer import Lamp, fresnel
from tests.oracles.pads import BASE, GAUSSIAN, MM, in_file_form, listed, painted
from tests.oracles.quadrature import irradiance

PHI, DARK = np.array([np.pi / 2]), 1e-4


def dark_pad(
    index: float, *, width: float = 20.0, place: tuple[float, ...] = (-7, 2, 1.5)
) -> Scene:
    """Return a clear pad with black edges and one lamp in it."""
    content = {part: dict(values) for part, values in BASE.items() if part != "fibers"}
    content["pad"] |= {"index": (index,), "width": (width, MM)}
    content["coating"]["albedo"] = (DARK,)
    content["baseline"] = {"lamps": ["red"]}
    lamp = listed(*place, 1, 0.2, 0.8) | {"profile": GAUSSIAN | {"sigma_v": (40.0, "deg")}}
    parts = {"lamps": [lamp], "faces": [painted("black", "tip", "right", "base")]}
    return Scene.model_validate({"schema": 2, "name": "dark"} | in_file_form(content | parts))


def closed_form(scene: Scene) -> np.ndarray:
    """Return what the camera sees of the untouched sites, ``(site,)`` in 1/(mm^2 sr)."""
    index, lamp, place = scene.pad.index, analog_lamp(scene, 0, np.pi / 2), facets(scene, 0.0)
    point, normal = place.site_position, place.site_normal[0]
    image = Lamp(lamp.center * [1, 1, -1], lamp.frame * [[1], [1], [-1]], lamp.radius, lamp.sigma_v)
    reflected = np.vectorize(lambda cosine: fresnel(cosine, 1.0 / index)[0])
    light = irradiance(point, normal, lamp)
    if index > 1.0:
        light = light + irradiance(point, normal, image, reflected)
    # Out through the lower face, all but straight.
    way = point - camera_origin(scene)
    seen = [1.0 - fresnel(float(cos), index)[0] for cos in way[:, 2] / np.linalg.norm(way, axis=1)]
    return scene.coating.albedo / (np.pi * index**2) * light * np.array(seen)


@pytest.mark.parametrize("index", [1.0, 1.41])
def test_the_preview_as_drawn_has_the_closed_form(index: float) -> None:
    scene = dark_pad(index)
    with Preview(scene) as preview:
        drawn = preview.transport(PHI, np.zeros(1))[1][0, 0, 0]
    np.testing.assert_allclose(drawn, closed_form(scene), rtol=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("index", [1.0, 1.41])
def test_the_converged_preview_has_the_closed_form(index: float) -> None:
    scene = dark_pad(index)
    effort = Effort(paths=256, arrivals=2_000_000)
    cells = transport_at(scene, 0.0, PHI, effort, Clock(1, None)).cells[0, 0, :, -1]
    truth = closed_form(scene)
    assert abs(cells.sum() / truth.sum() - 1.0) < 0.03
    np.testing.assert_allclose(cells, truth, rtol=0.15)


@pytest.mark.slow
@pytest.mark.parametrize("index", [1.0, 1.41])
def test_level_2_has_the_closed_form(mono: ModuleType, index: float) -> None:
    scene = dark_pad(index)
    estimate = render_transport(scene, PHI, np.zeros(1), samples=500)
    truth = closed_form(scene)
    found = estimate.background_replicates[:, 0, 0, 0].sum(axis=1) / truth.sum()
    ratio, error = found.mean(), found.std(ddof=1) / np.sqrt(len(found))
    assert error < 0.02
    assert abs(ratio - 1.0) < 3.5 * error
    # A site's own radiance, each with its error.
    z = (estimate.background[0, 0, 0] - truth) / estimate.background_se[0, 0, 0]
    assert np.abs(z).max() < 4.5


def test_without_a_face_it_does_not_matter_whether_a_lamp_is_in_the_pad() -> None:
    place = (-11.0, 2.0, 1.5)
    before, within = dark_pad(1.0, place=place), dark_pad(1.0, width=24.0, place=place)
    assert [scene.placed_lamps()[0].solid for scene in (before, within)] == [None, "pad"]
    light = []
    for scene in (before, within):
        with Preview(scene) as preview:
            light.append(preview.transport(PHI, np.zeros(1))[0][0, 0, 0])
    np.testing.assert_allclose(light[1], light[0], rtol=1e-4, atol=1e-12)
