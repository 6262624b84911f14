"""The smooth ratio finds a field through noise, also where it was not measured."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from hw.calibration.log_ratio import LogRatios
from hw.calibration.reference_lines import Setup
from hw.emulator.rig import SmoothRatio, random_parameters, rendered_images, true_images
from hw.errors import CalibrationError
from render.arrays import Array
from tactilux import baseline_design, load_scene
from tests.colored_skins import tinted_digit


def field(place: Array) -> Array:
    return 0.08 * np.sin(place[:, 0] / 5.0) * np.cos(place[:, 1] / 6.0)


def measured(noise: float, fibers: int = 6, seed: int = 0) -> list[LogRatios]:
    """Return noisy samples of one field, with another constant for every fiber."""
    rng = np.random.default_rng(seed)
    found = []
    for fiber in range(fibers):
        place = rng.uniform([-6.0, 1.0], [6.0, 14.0], (40, 2))
        values = 0.3 * fiber + field(place) + noise * rng.standard_normal(len(place))
        found.append(LogRatios(place, values, np.full(len(place), noise**2)))
    return found


def test_the_field_is_found_between_the_samples() -> None:
    smooth = SmoothRatio(measured(0.03))
    wanted = np.stack(np.meshgrid(np.linspace(-4, 4, 5), np.linspace(3, 12, 5)), -1).reshape(-1, 2)
    found = smooth.mean([wanted] * 6).reshape(6, -1)
    for fiber, values in enumerate(found):
        error = values - field(wanted) - 0.3 * fiber
        assert np.abs(error).max() < 0.03


def test_nothing_measured_is_no_ratio() -> None:
    empty = LogRatios(np.zeros((0, 2)), np.zeros(0), np.zeros(0))
    with pytest.raises(CalibrationError, match="no render"):
        SmoothRatio([empty])


@pytest.mark.slow
def test_too_few_light_paths_for_any_ratio_raise_one_clear_error(mono: ModuleType) -> None:
    scene = load_scene("finger20")
    setup = Setup(scene, baseline_design(scene).phi, np.zeros(1))
    with pytest.raises(
        CalibrationError, match=r"--rig-samples = 1 light .* at bend 0°.*: give more"
    ):
        rendered_images(setup, random_parameters(scene, 0), [[5]], samples=1)


def test_what_a_colored_skin_shows_in_a_channel_is_the_skin_of_that_albedo(tmp_path: Path) -> None:
    scene = load_scene(tinted_digit(tmp_path))
    setup = Setup(scene, baseline_design(scene).phi, np.zeros(1))
    truth = random_parameters(scene, 3)
    assert truth.material is not None
    images, built = true_images(setup, truth), truth.built(setup)
    assert images.shape[-1] == 3
    green = replace(built, scene=built.scene.with_albedo(float(truth.material[1])))
    alone = true_images(green, replace(truth, material=None, turn=np.zeros(3)))
    np.testing.assert_array_equal(images[..., 1], alone)
    assert not np.allclose(images[..., 0], alone)
