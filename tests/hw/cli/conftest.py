"""Photographs of an emulated rig as the model predicts it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from hw.camera.projection import pad_positions
from optimize.design import baseline_design
from render.arrays import Array
from render.geometry import flat_sites
from render.scene import load_scene
from surrogate.runtime import Checker

ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="session")
def fiber_photos() -> Array:
    """Draw every fiber of the baseline alone, ``(fiber, row, column, 3)``, 40 counts at most.

    Every pixel has the light of the nearest site: all that the check looks at.
    """
    scene = load_scene("finger20")
    design = baseline_design(scene)
    checker = Checker.load(ROOT / "models" / "finger20", threads=2)
    table = checker.transport_table(design.phi[:1], np.zeros(1))
    assert table.background is not None
    light = table.background[:, 0, 0] * checker.exposure
    flat = pad_positions(scene, 0.0, scene.camera.rows, scene.camera.columns)
    sites = flat_sites(scene)[:, :2]
    away = np.linalg.norm(np.nan_to_num(flat, nan=99.0)[:, :, None] - sites, axis=-1)
    nearest = away.argmin(axis=-1)
    seen = np.isfinite(flat[..., :1])
    return np.asarray(light[:, nearest][..., None] * design.power[:, None, None, :] * seen)


@pytest.fixture(scope="session")
def photographed(fiber_photos: Array) -> Callable[[Path, Array], Path]:
    """Write a sweep with given powers ``(fiber,)`` into a folder."""

    def write(folder: Path, power: Array) -> Path:
        folder.mkdir()
        rng = np.random.default_rng(0)
        for fiber, photo in enumerate(fiber_photos):
            noisy = 6.0 * power[fiber] * photo + 8.0 + 2.5 * rng.standard_normal(photo.shape)
            pixels = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
            Image.fromarray(pixels).save(folder / f"fiber-{fiber:02d}.png", compress_level=1)
        dark = np.clip(np.rint(8.0 + 0.4 * rng.standard_normal(photo.shape)), 0, 255)
        Image.fromarray(dark.astype(np.uint8)).save(folder / "dark.png", compress_level=1)
        return folder

    return write
