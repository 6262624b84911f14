"""A sensor as a Mitsuba scene looks the same to independent path samplers."""

from __future__ import annotations

from types import ModuleType

import numpy as np
import pytest

from render.reference import render_image
from render.scene import load_scene

WIDTH, HEIGHT = 6, 10
# Pixels in which the coating fills the picture.
COATED = np.s_[2:8, 1:5]


@pytest.mark.slow
@pytest.mark.parametrize("bend", [0.0, np.pi / 4])
def test_the_plugin_and_the_cell_sampler_draw_the_same_coating(
    mono: ModuleType, bend: float
) -> None:
    from render.optics.lit_scene import lit_scene

    scene = load_scene("finger20")
    phi = np.full(scene.lamp_count, np.pi / 2)
    power = np.zeros(scene.lamp_count)
    power[:8] = 1.0
    mitsuba_scene = lit_scene(scene, phi, power, bend, width=WIDTH, height=HEIGHT)
    integrator = mono.load_dict({"type": "bdpt", "error_bars": True, "replicates": 16})
    found = np.array(integrator.render(mitsuba_scene, spp=2000))[COATED]
    picture = render_image(
        scene, phi, np.repeat(power[:, None], 3, axis=1), bend, width=WIDTH, height=HEIGHT,
        samples=2000,
    )  # fmt: skip
    # The picture is mirrored: it is drawn as one looks at the finger from outside.
    expected, error = (a[:, ::-1, 0][COATED] for a in (picture.radiance, picture.se))
    score = (found[..., 0] - expected) / np.hypot(found[..., 1], error)
    assert np.abs(score).max() < 4.5
    assert np.abs(np.mean(score)) < 1.0
    assert (error / expected).max() < 0.5
