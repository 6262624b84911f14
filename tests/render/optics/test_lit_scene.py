"""A sensor as a Mitsuba scene looks the same to independent path samplers."""

from __future__ import annotations

from types import ModuleType

import numpy as np
import pytest

from render.reference import render_image
from render.scene import Scene, load_scene, unchecked
from tests.oracles.pads import scene_of_case

WIDTH, HEIGHT = 6, 10
# Pixels in which the coating fills the picture.
COATED = np.s_[2:8, 1:5]


@pytest.mark.slow
@pytest.mark.parametrize("bend", [0.0, np.pi / 4])
def test_the_plugin_and_the_cell_sampler_draw_the_same_coating(
    mono: ModuleType, bend: float
) -> None:
    agree(mono, load_scene("finger20"), bend, lamps=8, samples=2000)


@pytest.mark.slow
@pytest.mark.parametrize("case", ["cast in rough 0.1", "cast into a rim rough 0.1"])
def test_so_they_do_with_lamps_in_the_silicone(mono: ModuleType, case: str) -> None:
    scene = scene_of_case(case)
    # Small ones: disks are black in a Mitsuba scene, and a diffuser sends light back to them.
    small = tuple(unchecked(lamp, {"diameter": 0.2}) for lamp in scene.lamps or ())
    agree(mono, unchecked(scene, {"lamps": small}), 0.0, lamps=2, samples=1000)


def agree(mono: ModuleType, scene: Scene, bend: float, *, lamps: int, samples: int) -> None:
    """Hold ``bdpt`` on the lit scene against the picture of the cell sampler."""
    from render.optics.lit_scene import lit_scene

    phi = np.full(scene.lamp_count, np.pi / 2)
    power = np.zeros(scene.lamp_count)
    power[:lamps] = 1.0
    mitsuba_scene = lit_scene(scene, phi, power, bend, width=WIDTH, height=HEIGHT)
    integrator = mono.load_dict({"type": "bdpt", "error_bars": True, "replicates": 16})
    found = np.array(integrator.render(mitsuba_scene, spp=samples))[COATED]
    picture = render_image(
        scene, phi, np.repeat(power[:, None], 3, axis=1), bend, width=WIDTH, height=HEIGHT,
        samples=samples,
    )  # fmt: skip
    # The picture is mirrored: it is drawn as one looks at the finger from outside.
    expected, error = (a[:, ::-1, 0][COATED] for a in (picture.radiance, picture.se))
    score = (found[..., 0] - expected) / np.hypot(found[..., 1], error)
    assert np.abs(score).max() < 4.5
    assert np.abs(np.mean(score)) < 1.0
    assert (error / expected).max() < 0.5
