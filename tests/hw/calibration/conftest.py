"""A table of materials with a known, simple physics: fits are quick and truths are known."""

from __future__ import annotations

import numpy as np
import pytest

from hw.calibration.material import HIGH, LOW
from hw.calibration.material_table import MaterialTable, _fitted, sobol_materials
from hw.calibration.reference_lines import reference_lines
from render.bending import Array
from render.scene import Scene, load_scene

BENDS = np.array([0.0, np.pi / 2])


def toy_log_light(scene: Scene, material: Array) -> Array:
    """Return log light ``(bend, fiber, point)`` that spreads with scattering and beam width."""
    lines = reference_lines(scene)
    scattering, absorption, sigma_v, roughness = material
    offset = lines.place
    across = np.where(lines.line < 3, offset, 0.0)
    along = np.where(lines.line < 3, np.array([2.0, 5.0, 8.0, 0.0])[lines.line], offset)
    width = 2.0 + 6.0 * sigma_v + 0.25 * along
    shape = -np.log(1 + (across / width) ** 2) - 0.4 * np.log(scattering)
    shape = shape - (1.2 + 0.35 * np.log(scattering)) * np.log(along + 2.0)
    shape = shape - 2.0 * absorption * (2.0 + np.hypot(across, along))
    shape = shape + 0.5 * roughness * np.cos(across)
    bent = shape - 0.05 * along
    drawn = np.stack([shape, bent])[:, None].repeat(scene.fibers.count, axis=1)
    return np.where(lines.inside, drawn - 5.0, np.nan)


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
