"""Renders of several materials correct the table for all of them, and say how sure they are."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from hw.calibration.material_correction import MaterialCorrection
from hw.calibration.material_table import MaterialTable
from hw.calibration.pad_light import BLOCKS, MaterialRender, PadLight
from hw.calibration.reference_lines import frame_positions, in_frame, reference_lines
from render.arrays import Array
from render.scene import Scene
from tests.hw.calibration.toy import BENDS, SPACE, toy

LIT = [[2, 9], [11]]
"""Few fibers: what one says holds for all."""
NEW = np.array([1.2, 0.02, 0.25, 0.08])
"""A material that is not rendered."""
MATERIALS = SPACE.sobol(12)


def ratio(material: Array, across: Array, away: Array) -> Array:
    """Return by how much log light is more than the table's: a field that the material changes."""
    unit = SPACE.terms(material[None])[0][[1, 3, 5, 10]]
    field = np.sin(across / 4.0) * np.exp(-away / 6.0)
    return np.asarray(0.2 * field * (1 + 0.5 * unit.sum()))


def render(scene: Scene, material: Array, size: float, noise: float, seed: int) -> MaterialRender:
    """Return light of the toy times ``size`` times the ratio, each part with noise of its own."""
    radiance = np.full((len(BENDS), 20, 15 * BLOCKS, 9 * BLOCKS), np.nan)
    light = PadLight(2.0, BLOCKS, radiance, noise * np.ones(radiance.shape))
    rng = np.random.default_rng(seed)
    for bend, fibers in enumerate(LIT):
        for fiber in fibers:
            across, away = np.moveaxis(in_frame(scene, fiber, light.positions()), -1, 0)
            away = np.maximum(away, 0.0)
            shape = toy(material, across, away, bend) + size * ratio(material, across, away)
            parts = rng.standard_normal((30, 18)).repeat(BLOCKS // 2, 0).repeat(BLOCKS // 2, 1)
            radiance[bend, fiber] = np.exp(shape + noise * parts - 0.5 * noise**2)
    return MaterialRender(material, PadLight(2.0, BLOCKS, radiance, noise * radiance))


def corrected(
    scene: Scene, table: MaterialTable, materials: Array, size: float, noise: float, seed: int = 0
) -> MaterialCorrection:
    """Return the toy's table as renders of ``materials`` correct it."""
    renders = [
        render(scene, one, size, noise, 100 * seed + number) for number, one in enumerate(materials)
    ]
    return MaterialCorrection(table, renders, read(LIT), reference_lines(scene))


def read(lit: list[list[int]]) -> NDArray[np.bool_]:
    """Return that photographs show all points of the fibers that are lit."""
    shown = np.zeros((len(BENDS), 20, len(frame_positions())), dtype=np.bool_)
    for bend, fibers in enumerate(lit):
        shown[bend, fibers] = True
    return shown


def misses(found: MaterialCorrection, table: MaterialTable, size: float) -> tuple[Array, Array]:
    """Return errors of the correction at `NEW` and their stated spread, shapes only."""
    true = size * ratio(NEW, *frame_positions().T)
    errors, spreads = [], []
    modes = found.modes(NEW)
    for bend, fibers in enumerate(LIT):
        for fiber in fibers:
            change = found.table.log_light(NEW) - table.log_light(NEW)
            on = np.isfinite(change[bend, fiber])
            error = change[bend, fiber, on] - true[on]
            own = modes[bend][:, fiber, on]
            errors.append(error - error.mean())
            spreads.append(np.sqrt(((own - own.mean(axis=1, keepdims=True)) ** 2).sum(axis=0)))
    return np.concatenate(errors), np.concatenate(spreads)


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def test_a_material_that_was_not_rendered_is_corrected(scene: Scene, table: MaterialTable) -> None:
    true = ratio(NEW, *frame_positions().T)
    errors, _ = misses(corrected(scene, table, MATERIALS, 1.0, 0.04), table, 1.0)
    assert rms(errors) < 0.2 * rms(true - true.mean())


def test_the_stated_spread_is_that_of_the_errors(scene: Scene, table: MaterialTable) -> None:
    several = [
        misses(corrected(scene, table, MATERIALS, 1.0, 0.08, seed), table, 1.0) for seed in range(3)
    ]
    errors, spreads = (np.concatenate(parts) for parts in zip(*several, strict=True))
    assert 0.5 < rms(errors) / rms(spreads) < 1.6


def test_noise_alone_asks_for_no_correction(scene: Scene, table: MaterialTable) -> None:
    errors, _ = misses(corrected(scene, table, MATERIALS, 0.0, 0.06), table, 0.0)
    assert rms(errors) < 0.01


def test_one_render_is_least_sure_about_other_materials(scene: Scene, table: MaterialTable) -> None:
    found = corrected(scene, table, NEW[None], 1.0, 0.02)
    far = np.array([0.6, 0.05, 0.17, 0.22])
    near, away = (rms(found.modes(one)[0][:, LIT[0]]) for one in (NEW, far))
    errors, _ = misses(found, table, 1.0)
    assert rms(errors) < 0.02
    assert away > 1.2 * near


def test_fibers_that_were_not_rendered_are_not_corrected(
    scene: Scene, table: MaterialTable
) -> None:
    found = corrected(scene, table, MATERIALS[:2], 1.0, 0.05)
    same = np.ones(20, dtype=np.bool_)
    same[LIT[0]] = False
    np.testing.assert_array_equal(
        found.table.coefficients[:, 0, same], table.coefficients[:, 0, same]
    )
    assert not found.modes(NEW)[1][:, LIT[0]].any()


def test_a_bend_without_renders_is_left_as_it_is(scene: Scene, table: MaterialTable) -> None:
    renders = [render(scene, MATERIALS[0], 1.0, 0.05, 0)]
    found = MaterialCorrection(table, renders, read([LIT[0], []]), reference_lines(scene))
    np.testing.assert_array_equal(found.table.coefficients[:, 1], table.coefficients[:, 1])
    assert found.modes(NEW)[1].shape[0] == 0


@pytest.mark.parametrize("count", [1, 12])
def test_the_correction_is_finite(scene: Scene, table: MaterialTable, count: int) -> None:
    found = corrected(scene, table, MATERIALS[:count], 1.0, 0.05)
    np.testing.assert_array_equal(
        np.isfinite(found.table.coefficients), np.isfinite(table.coefficients)
    )
