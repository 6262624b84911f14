"""The share of noise in what facets differ by, of transport whose noise is known."""

from __future__ import annotations

import numpy as np
import pytest

from render.noise_share import UNCONVERGED_SHARE, converging_effort, noise_share
from tests.render.noisy_light import EXPOSURE, REPLICATES, SHAPE, THREE, noisy_light


@pytest.mark.parametrize("noise", [0.01, 0.03, 0.1])
def test_the_share_is_the_root_of_the_noises_part_of_the_variance(noise: float) -> None:
    found = noise_share(noisy_light(0.03, noise), THREE, EXPOSURE)
    assert found == pytest.approx(noise / np.hypot(0.03, noise), rel=0.05)


def test_two_halves_of_a_render_tell_the_share_as_well() -> None:
    light = noisy_light(0.03, 0.03)
    halves = np.stack([light[start::2].mean(axis=0) for start in (0, 1)])
    assert noise_share(halves, THREE, EXPOSURE) == pytest.approx(np.sqrt(0.5), rel=0.1)


def test_facets_that_noise_alone_makes_different_are_all_noise() -> None:
    found = noise_share(noisy_light(0.0, 0.02), THREE, EXPOSURE)
    assert found == pytest.approx(1.0, abs=0.05)


def test_light_without_noise_has_none_whether_facets_differ_or_not() -> None:
    for light in (noisy_light(0.05, 0.0), np.ones((REPLICATES, *SHAPE))):
        assert noise_share(light, THREE, EXPOSURE) == pytest.approx(0.0, abs=1e-6)


def test_one_channel_has_no_hues_to_weigh() -> None:
    found = noise_share(noisy_light(0.03, 0.03), np.ones((3, 1)), EXPOSURE)
    assert found == pytest.approx(np.sqrt(0.5), rel=0.1)


def test_the_effort_asked_for_leaves_the_share_that_scores_converge_at() -> None:
    effort = converging_effort(noise_share(noisy_light(0.03, 0.06), THREE, EXPOSURE))
    left = noise_share(noisy_light(0.03, 0.06 / np.sqrt(effort), seed=1), THREE, EXPOSURE)
    assert left == pytest.approx(UNCONVERGED_SHARE, rel=0.1)
