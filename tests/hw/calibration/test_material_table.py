"""The table is smooth in the material, and knows its own error."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hw.calibration.material_table import MaterialTable, material_table
from hw.calibration.reference_lines import Setup, sample_image
from render.arrays import Array
from render.scene import Scene
from tests.hw.calibration.toy import BENDS, SPACE, toy_log_light

PHI = np.full(20, np.pi / 2)


def test_light_between_materials_is_that_of_the_physics(scene: Scene, table: MaterialTable) -> None:
    rng = np.random.default_rng(5)
    for _ in range(5):
        material = SPACE.low + rng.uniform(0.15, 0.85, 4) * (SPACE.high - SPACE.low)
        error = table.log_light(material) - toy_log_light(scene, material)
        assert np.nanstd(error) < 0.02


def test_left_out_errors_are_of_the_size_of_true_ones(scene: Scene, table: MaterialTable) -> None:
    inner = np.abs(table.left_out[: len(table.left_out) // 2])
    assert 0.0015 < np.nanmedian(inner) < 0.02


def test_materials_fill_their_range() -> None:
    materials = SPACE.sobol(32)
    assert (materials >= SPACE.low).all()
    assert (materials <= SPACE.high).all()
    assert (materials.min(axis=0) < SPACE.low + 0.1 * (SPACE.high - SPACE.low)).all()
    assert (materials.max(axis=0) > SPACE.high - 0.1 * (SPACE.high - SPACE.low)).all()


def test_the_key_does_not_depend_on_the_scenes_own_material(scene: Scene) -> None:
    other = SPACE.put_into(scene, np.array([0.7, 0.03, 0.2, 0.2]))
    key = Setup(scene, PHI, BENDS).key(4)
    assert Setup(other, PHI, BENDS).key(4) == key
    assert Setup(scene, PHI + 0.1, BENDS).key(4) != key
    assert Setup(scene, PHI, BENDS[:1]).key(4) != key
    assert Setup(scene, PHI, BENDS).key(5) != key


def test_drawing_goes_on_where_it_stood_and_draws_damaged_parts_again(
    scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[int] = []

    def line_light(own: Setup, *, seed: int, **_: object) -> Array:
        if len(drawn) == 20:
            raise KeyboardInterrupt
        drawn.append(seed)
        return np.exp(toy_log_light(scene, SPACE.of(own.scene)))

    monkeypatch.setattr("hw.calibration.material_table.line_light", line_light)
    with pytest.raises(KeyboardInterrupt):
        material_table(Setup(scene, PHI, BENDS), folder=tmp_path)
    first, drawn[:] = list(drawn), []
    (kept,) = (path for path in tmp_path.iterdir())
    (kept / "003.npz").write_bytes(b"half a file")
    whole = material_table(Setup(scene, PHI, BENDS), folder=tmp_path)
    assert sorted(first + drawn[1:]) == list(range(1000, 1032))
    assert drawn[0] == 1003
    drawn.clear()
    again = material_table(Setup(scene, PHI, BENDS), folder=tmp_path)
    assert not drawn
    np.testing.assert_array_equal(again.coefficients, whole.coefficients)


def test_images_are_read_between_the_middles_of_pixels() -> None:
    image = np.arange(12.0).reshape(3, 4)
    pixels = np.array([[0.5, 0.5], [1.0, 0.5], [3.5, 2.5], [np.nan, np.nan]])
    np.testing.assert_allclose(sample_image(image, pixels), [0.0, 0.5, 11.0, np.nan])


def test_material_goes_into_a_scene_and_out_again(scene: Scene) -> None:
    material = np.array([0.8, 0.03, np.radians(12.0), 0.2])
    own = SPACE.put_into(scene, material)
    np.testing.assert_allclose(SPACE.of(own), material)
    assert own.diffuser is not None
    assert scene.diffuser is not None
    assert own.diffuser.g == scene.diffuser.g
