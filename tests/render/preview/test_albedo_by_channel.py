"""Skins with an albedo per channel at level 0: each channel is the scene of its albedo."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from render.choose_exposure import baseline_power, scene_scale
from render.preview import Preview
from render.preview.converged import Effort, task_count, transport_at
from render.progress import Clock
from render.scene import Scene
from tests.colored_skins import ALBEDOS, skin_of, stacked

PHI, FLAT = np.array([0.6, np.pi / 2]), np.array([0.0])
LOBE = {
    "specular": {"value": 0.2, "source": "test"},
    "roughness": {"value": 0.3, "source": "test"},
}
QUICK = Effort(photons=2000, paths=512, arrivals=30_000)


def drawn(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    with Preview(scene) as preview:
        return preview.transport(PHI, FLAT)


def followed(scene: Scene) -> tuple[np.ndarray, ...]:
    found = transport_at(scene, 0.0, PHI, QUICK, Clock(task_count(scene, QUICK), None))
    return found.cells, found.grain


def skin_light(scene: Scene) -> tuple[np.ndarray]:
    with Preview(scene) as preview:
        return (preview.skin(PHI, FLAT),)


def picture(scene: Scene) -> np.ndarray:
    power = np.random.default_rng(0).uniform(0.1, 1.0, (scene.lamp_count, 3))
    with Preview(scene) as preview:
        return preview.picture(np.full(scene.lamp_count, 1.2), power, 0.0, 24, 36)


@pytest.mark.parametrize("light", [drawn, followed, skin_light])
@pytest.mark.parametrize("case", ["smooth", "rim rough 0.1"])
def test_each_channel_is_the_scene_of_its_albedo_to_the_last_bit(
    light: Callable[[Scene], tuple[np.ndarray, ...]], case: str
) -> None:
    scene = skin_of(case=case)
    alone = [light(one) for one in scene.one_albedo_scenes]
    for number, found in enumerate(light(scene)):
        np.testing.assert_array_equal(found, stacked([each[number] for each in alone]))


@pytest.mark.parametrize("light", [drawn, followed])
def test_with_a_lobe_too_each_channel_is_the_scene_of_its_albedo(
    light: Callable[[Scene], tuple[np.ndarray, ...]],
) -> None:
    scene = skin_of(coating=LOBE)
    alone = [light(one) for one in scene.one_albedo_scenes]
    for number, found in enumerate(light(scene)):
        np.testing.assert_array_equal(found, stacked([each[number] for each in alone]))


@pytest.mark.parametrize("parts", [{}, {"coating": LOBE}])
def test_each_channel_of_a_picture_is_that_of_its_albedo(parts: dict[str, Any]) -> None:
    scene = skin_of(**parts)
    alone = [picture(one) for one in scene.one_albedo_scenes]
    seen = picture(scene)
    for channel, one in enumerate(alone):
        np.testing.assert_array_equal(seen[..., channel], one[..., channel])
    assert np.ptp([one[..., 0].mean() for one in alone]) > 0.1 * seen.mean()


def test_equal_albedos_have_no_axis_of_channels() -> None:
    np.testing.assert_array_equal(drawn(skin_of((0.4,) * 3))[0], drawn(skin_of(0.4))[0])


@pytest.mark.parametrize("light", [drawn, lambda scene: (followed(scene)[0][..., -1, :],) * 2])
def test_in_air_a_flat_skin_is_as_bright_as_its_albedo(
    light: Callable[[Scene], tuple[np.ndarray, np.ndarray]],
) -> None:
    # A Lambertian skin sends albedo E / pi, and nothing comes back to it (closed form).
    scene = skin_of(pad={"index": {"value": 1.0, "source": "air"}})
    _, background = light(scene)
    assert background.min() > 0.0
    ratio = background / np.array(ALBEDOS)
    np.testing.assert_allclose(ratio, np.broadcast_to(ratio[..., :1], ratio.shape), rtol=1e-6)


def test_in_silicone_light_to_and_fro_makes_a_white_skin_brighter_still() -> None:
    _, background = drawn(skin_of())
    ratio = (background / np.array(ALBEDOS)).mean(axis=(0, 1, 2, 3))
    assert ratio[0] > 1.005 * ratio[2] > 1.005**2 * ratio[1]


def test_the_scale_is_of_the_baseline_as_each_channel_sees_it() -> None:
    scene = skin_of()
    with Preview(scene) as preview:
        light, _ = preview.transport(np.array([np.pi / 2]), FLAT)
    counts = np.einsum("fbskc,fc->bskc", light[:, 0], baseline_power(scene))
    assert np.percentile(scene_scale(scene).exposure * counts, 99.5) == pytest.approx(230.0)
