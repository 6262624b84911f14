"""Skins with an albedo per channel at level 2: one render for each albedo, stacked."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from render.reference import (
    TimeBudget,
    TransportEstimate,
    render_image,
    render_transport,
    transport_jobs,
)
from render.reference.transport import ARRAYS
from render.scene import Scene
from tests.colored_skins import ALBEDOS, skin_of, stacked

PHI, FLAT = np.array([np.pi / 2]), np.array([0.0])
TINY: dict[str, Any] = {"samples": 4, "seeds": (1,), "replicates": 2}


def rendered(scene: Scene) -> TransportEstimate:
    return render_transport(scene, PHI, FLAT, **TINY)


def test_each_channel_is_the_render_of_its_albedo_to_the_last_bit() -> None:
    scene = skin_of((0.7, 0.3, 0.7))
    found, alone = rendered(scene), [rendered(one) for one in scene.one_albedo_scenes]
    for name in ARRAYS:
        parts = [getattr(alone[albedo], name) for albedo in (0, 1, 0)]
        np.testing.assert_array_equal(getattr(found, name), stacked(parts), err_msg=name)
    assert found.T.shape[-1] == 3
    assert found.settings == alone[0].settings


def test_a_render_of_one_albedo_serves_every_scene_that_has_it() -> None:
    def keys(scene: Scene) -> set[str]:
        return {job.key for job in transport_jobs(scene, PHI, FLAT, samples=4, seeds=[1])}

    assert keys(skin_of((0.7, 0.3, 0.7))) == keys(skin_of(0.7)) | keys(skin_of(0.3))
    assert len(keys(skin_of((0.7, 0.3, 0.7)))) == 4


@pytest.mark.slow
def test_in_air_a_flat_skin_is_as_bright_as_its_albedo() -> None:
    # A Lambertian skin sends albedo E / pi, nothing comes back to it, and all channels have the
    # same light paths.
    scene = skin_of(pad={"index": {"value": 1.0, "source": "air"}})
    background = rendered(scene).background
    lit = background[..., 0] > 0.0
    assert lit.any()
    ratio = (background / np.array(ALBEDOS))[lit]
    np.testing.assert_allclose(ratio, np.broadcast_to(ratio[:, :1], ratio.shape), rtol=1e-5)


@pytest.mark.parametrize("dark", [pytest.param((), marks=pytest.mark.slow), (1,)])
def test_each_channel_of_a_picture_is_that_of_its_albedo(dark: tuple[int, ...]) -> None:
    scene = skin_of()
    power = np.random.default_rng(0).uniform(0.1, 1.0, (scene.lamp_count, 3))
    power[:, list(dark)] = 0.0
    size: dict[str, Any] = {"width": 12, "height": 18, "samples": 8}
    phi = np.full(scene.lamp_count, 1.2)
    found = render_image(scene, phi, power, 0.0, **size)
    assert found.radiance[..., 0].sum() > 0.0
    for channel, one in enumerate(scene.one_albedo_scenes):
        if channel in dark:
            assert not found.radiance[..., channel].any()
            continue
        alone = render_image(one, phi, power[:, channel : channel + 1], 0.0, **size)
        np.testing.assert_array_equal(found.radiance[..., channel], alone.radiance[..., 0])
        np.testing.assert_array_equal(found.se[..., channel], alone.se[..., 0])


@pytest.mark.slow
def test_a_time_is_shared_out_to_all_albedos() -> None:
    scene, now = skin_of(), [0.0]

    def clock() -> float:
        now[0] += 1.0
        return now[0]

    budget = TimeBudget(60.0, began=0.0, clock=clock)
    power = np.ones((scene.lamp_count, 3))
    found = render_image(scene, np.full(2, 1.2), power, 0.0, width=6, height=9, budget=budget)
    assert (found.radiance.sum(axis=(0, 1)) > 0.0).all()
    assert 50.0 < now[0] < 70.0
