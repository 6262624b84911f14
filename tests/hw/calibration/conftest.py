"""A table of materials with a known, simple physics: fits are quick and truths are known."""

from __future__ import annotations

import numpy as np
import pytest

from hw.calibration.material import HIGH, LOW
from hw.calibration.material_table import MaterialTable, _fitted, sobol_materials
from hw.calibration.reference_lines import frame_positions, reference_lines
from hw.camera.projection import pad_positions
from render.arrays import Array
from render.geometry.layout import flat_fiber_poses
from render.scene.schema import Scene, load_scene

BENDS = np.array([0.0, np.pi / 2])


def toy_log_light(scene: Scene, material: Array) -> Array:
    """Return log light ``(bend, fiber, point)`` at the reference lines."""
    across, along = frame_positions().T
    drawn = np.stack([toy(material, across, along, bend) for bend in (0, 1)])
    drawn = drawn[:, None].repeat(scene.fibers.count, axis=1)
    return np.where(reference_lines(scene).inside, drawn, np.nan)


def toy_images(scene: Scene, material: Array, rows: int, columns: int) -> Array:
    """Return what the camera sees of each fiber's light, ``(bend, fiber, row, column)``."""
    poses = flat_fiber_poses(scene)
    assert scene.diffuser is not None
    margin = scene.fibers.gap + scene.diffuser.thickness
    images = []
    for bend, angle in enumerate(BENDS):
        flat = pad_positions(scene, float(angle), rows, columns)
        away = flat - poses.position[:, None, None, :2]
        across = np.einsum("frcx,fx->frc", away, poses.along[:, :2])
        along = np.einsum("frcx,fx->frc", away, poses.inward[:, :2]) - margin
        images.append(np.exp(toy(material, across, np.maximum(along, 0.0), bend)))
    return np.nan_to_num(np.stack(images)).astype(np.float32)


def toy(material: Array, across: Array, along: Array, bend: int) -> Array:
    """Return log light at distances (mm) from the fiber's axis and from the pad's edge.

    The beam's width shows across the light, scattering along it, absorption far away.
    """
    scattering, absorption, sigma_v, roughness = material
    width = 2.0 + 6.0 * sigma_v + 0.25 * along
    shape = -np.log(1 + (across / width) ** 2) - 0.4 * np.log(scattering)
    shape = shape - (1.2 + 0.35 * np.log(scattering)) * np.log(along + 2.0)
    shape = shape - 2.0 * absorption * (2.0 + np.hypot(across, along))
    shape = shape + 0.5 * roughness * np.cos(across)
    return np.asarray(shape - 0.05 * along * bend - 5.0)


@pytest.fixture(scope="session")
def scene() -> Scene:
    """Return the default sensor."""
    return load_scene("finger20")


@pytest.fixture(scope="session")
def table(scene: Scene) -> MaterialTable:
    """Return the toy's table, with a little noise as random walks leave."""
    materials = sobol_materials(32)
    rng = np.random.default_rng(0)
    drawn = np.stack([toy_log_light(scene, one) for one in materials])
    drawn = drawn + 0.003 * rng.standard_normal(drawn.shape)
    assert (materials >= LOW).all()
    assert (materials <= HIGH).all()
    return _fitted("toy", np.full(20, np.pi / 2), BENDS, materials, drawn)
