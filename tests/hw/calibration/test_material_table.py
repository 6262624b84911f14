"""The table is smooth in the material, and knows its own error."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hw.calibration.material import HIGH, LOW, Material
from hw.calibration.material_table import (
    MaterialTable,
    load_table,
    material_table,
    sample,
    sobol_materials,
    table_key,
)
from render.errors import TableError
from render.files import write_npz
from render.scene.schema import Scene
from tests.hw.calibration.conftest import BENDS, toy_log_light

PHI = np.full(20, np.pi / 2)


def test_light_between_materials_is_that_of_the_physics(scene: Scene, table: MaterialTable) -> None:
    rng = np.random.default_rng(5)
    for _ in range(5):
        material = LOW + rng.uniform(0.15, 0.85, 4) * (HIGH - LOW)
        error = table.log_light(material) - toy_log_light(scene, material)
        assert np.nanstd(error) < 0.02


def test_left_out_errors_are_of_the_size_of_true_ones(scene: Scene, table: MaterialTable) -> None:
    inner = np.abs(table.left_out[: len(table.left_out) // 2])
    assert 0.0015 < np.nanmedian(inner) < 0.02


def test_materials_fill_their_range() -> None:
    materials = sobol_materials(32)
    assert (materials.min(axis=0) < LOW + 0.1 * (HIGH - LOW)).all()
    assert (materials.max(axis=0) > HIGH - 0.1 * (HIGH - LOW)).all()


def test_the_key_does_not_depend_on_the_scenes_own_material(scene: Scene) -> None:
    other = Material(0.7, 0.03, 0.2, 0.2).put_into(scene)
    assert table_key(scene, PHI, BENDS) == table_key(other, PHI, BENDS)
    assert table_key(scene, PHI, BENDS) != table_key(scene, PHI + 0.1, BENDS)
    assert table_key(scene, PHI, BENDS) != table_key(scene, PHI, BENDS[:1])


def test_too_few_materials_are_refused_before_they_are_drawn(scene: Scene, tmp_path: Path) -> None:
    from hw.errors import CalibrationError

    with pytest.raises(CalibrationError, match="too few"):
        material_table(scene, PHI, BENDS, folder=tmp_path, materials=8, rays=2000)


def test_a_damaged_table_is_refused(tmp_path: Path) -> None:
    write_npz(tmp_path / "materials.npz", {"key": np.array("x")})
    with pytest.raises(TableError, match="delete it"):
        load_table(tmp_path / "materials.npz")


def test_images_are_read_between_the_middles_of_pixels() -> None:
    image = np.arange(12.0).reshape(3, 4)
    pixels = np.array([[0.5, 0.5], [1.0, 0.5], [3.5, 2.5], [np.nan, np.nan]])
    np.testing.assert_allclose(sample(image, pixels), [0.0, 0.5, 11.0, np.nan])


def test_material_goes_into_a_scene_and_out_again(scene: Scene) -> None:
    material = Material(0.8, 0.03, np.radians(12.0), 0.2)
    own = material.put_into(scene)
    np.testing.assert_allclose(Material.of(own).array(), material.array())
    assert own.diffuser is not None
    assert scene.diffuser is not None
    assert own.diffuser.g == scene.diffuser.g
