"""Renders correct the model where they know better, and say how sure they are."""

from __future__ import annotations

import numpy as np

from hw.calibration.reference_lines import reference_lines
from hw.calibration.rendered_correction import Render, rendered_correction
from hw.pad_light import BLOCKS, PadLight
from render.bending import Array
from render.scene import Scene
from tests.hw.calibration.conftest import toy_log_light

MATERIAL = np.array([1.0, 0.01, 0.26, 0.1])
CELL = 2.0
LIT = [list(range(0, 20, 2)), list(range(1, 20, 2))]


def rendered(scene: Scene, ratio: float, noise: float, seed: int) -> tuple[PadLight, Array]:
    """Return light ``ratio`` times a slope towards the tip over a flat model, with cell noise.

    The model's log light is 0 everywhere, so that only the ratio is to be found.
    """
    rows, columns = 15 * BLOCKS, 9 * BLOCKS
    y = (np.arange(rows) + 0.5) * CELL / BLOCKS - 15.0
    log_ratio = ratio * np.broadcast_to(np.sin(y / 6.0)[:, None], (rows, columns))
    rng = np.random.default_rng(seed)
    radiance = np.full((2, 20, rows, columns), np.nan)
    for bend, fibers in enumerate(LIT):
        for fiber in fibers:
            cells = rng.standard_normal((15, 9)).repeat(BLOCKS, 0).repeat(BLOCKS, 1)
            radiance[bend, fiber] = np.exp(log_ratio) * (1 + noise * cells)
    flat = np.where(np.isfinite(toy_log_light(scene, MATERIAL)), 0.0, np.nan)
    return PadLight(CELL, BLOCKS, radiance, noise * np.abs(radiance)), flat


def misses(scene: Scene, ratio: float, noise: float, seed: int) -> tuple[Array, Array]:
    """Return error of the correction and its stated spread at all points, shapes only."""
    light, flat = rendered(scene, ratio, noise, seed)
    lines = reference_lines(scene)
    found = rendered_correction([Render(light, flat)], lines)
    errors, spreads = [], []
    for bend, fibers in enumerate(LIT):
        for fiber in fibers:
            on = np.isfinite(flat[bend, fiber])
            true = ratio * np.sin(lines.position[fiber, on, 1] / 6.0)
            error = found.log_ratio[bend, fiber, on] - true
            modes = found.modes[bend][:, fiber, on]
            errors.append(error - error.mean())
            shapes = modes - modes.mean(axis=1, keepdims=True)
            spreads.append(np.sqrt((shapes**2).sum(axis=0)))
    return np.concatenate(errors), np.concatenate(spreads)


def test_a_smooth_ratio_is_found_through_the_noise(scene: Scene) -> None:
    errors, _ = misses(scene, 0.10, 0.05, 0)
    assert np.sqrt(np.mean(errors**2)) < 0.02


def test_its_spread_is_that_of_its_errors(scene: Scene) -> None:
    several = [misses(scene, 0.08, 0.06, seed) for seed in range(4)]
    errors, spreads = (np.concatenate(parts) for parts in zip(*several, strict=True))
    scale = np.sqrt(np.mean(errors**2) / np.mean(spreads**2))
    assert 0.6 < scale < 1.5


def test_noise_alone_asks_for_no_correction(scene: Scene) -> None:
    errors, _ = misses(scene, 0.0, 0.06, 1)
    assert np.sqrt(np.mean(errors**2)) < 0.012


def test_what_was_not_rendered_is_not_corrected(scene: Scene) -> None:
    light, flat = rendered(scene, 0.1, 0.05, 2)
    found = rendered_correction([Render(light, flat)], reference_lines(scene))
    assert not found.log_ratio[0, 1::2].any()
    assert not found.modes[1][:, ::2].any()
