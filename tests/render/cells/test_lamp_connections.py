"""Lamps that are met and lamps that are joined share the light of a bare coating without a rest."""

from __future__ import annotations

from types import ModuleType

import numpy as np
import pytest

from render.cells import lamp_connections
from render.geometry import facets
from render.reference import render_transport
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
