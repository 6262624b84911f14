"""Lamps that are met and lamps that are joined share the light of a bare coating without a rest."""

from __future__ import annotations

from types import ModuleType

import numpy as np
import pytest

from render.cells import lamp_connections
from render.geometry import facets
from render.reference import pad_cells, render_transport
from render.sampling.monte_carlo import MonteCarlo
from render.scene import Scene
from tests.oracles.analog_cells import analog_lamp
from tests.oracles.pads import scene_of_case
from tests.oracles.quadrature import irradiance

PHI = 1.2


def radiance_of_sites(scene: Scene) -> np.ndarray:
    """Return ``(fiber, site)`` of direct light alone, by quadrature over the lamps' disks."""
    place = facets(scene, 0.0)
    normal = place.site_normal[0]  # of a flat pad, everywhere
    lamps = [analog_lamp(scene, fiber, PHI) for fiber in range(scene.lamp_count)]
    arriving = [irradiance(place.site_position, normal, lamp) for lamp in lamps]
    return scene.coating.albedo / np.pi * np.array(arriving)


@pytest.mark.slow
@pytest.mark.parametrize("left_out", [None, "met", "joined"])
def test_a_bare_coating_has_the_light_of_the_closed_form(
    mono: ModuleType, monkeypatch: pytest.MonkeyPatch, left_out: str | None
) -> None:
    if left_out is not None:
        whole = getattr(lamp_connections.Lamp, left_out)
        monkeypatch.setattr(
            lamp_connections.Lamp, left_out, lambda *given: [0.0 * v for v in whole(*given)]
        )
    scene = scene_of_case("no face")
    estimate = render_transport(scene, np.array([PHI]), np.array([0.0]), samples=300)
    truth = radiance_of_sites(scene)
    found = estimate.background_replicates[:, :, 0, 0].sum(axis=(1, 2)) / truth.sum()
    ratio, error = found.mean(), found.std(ddof=1) / np.sqrt(len(found))
    assert error < 0.03
    if left_out is None:
        assert abs(ratio - 1.0) < 3.5 * error
    else:
        # Either way alone is but a part: their weights add up to one.
        assert ratio < 1.0 - 3.5 * error


def test_aimed_subpaths_change_the_noise_of_a_smooth_pad_and_not_its_light(
    mono: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    from render.cells.cell_sampler import PadSampler

    scene = scene_of_case("smooth")
    levels, errors = [], []
    for samples in (100, 500):
        # One lamp at a time, as on pads where not all are served at once.
        cells = pad_cells(scene, np.full((scene.lamp_count, 1), PHI), 0.0, False, sampler="pssmlt")
        run = MonteCarlo(cells, 16 * samples, 16, 1)
        run.sample(1)
        found = run.estimate().sum(axis=(1, 2))
        levels.append(found.mean())
        errors.append(found.std(ddof=1) / 4)
        # With few samples aimed subpaths, with many none.
        monkeypatch.setattr(PadSampler, "aimed", lambda *given: None)
    assert abs(levels[0] - levels[1]) < 3.5 * np.hypot(*errors)
    assert np.hypot(*errors) < 0.1 * levels[0]
    assert errors[0] ** 2 * 100 < errors[1] ** 2 * 500
