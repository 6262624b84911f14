"""Training cells, their groups, and the regression data made of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from render.errors import TableError
from render.geometry import mirror_twins
from render.scene import Scene
from render.transport import TransportTable
from surrogate.model.preview_grid import PreviewGrid
from surrogate.training.dataset import (
    build_rows,
    folds,
    interior_folds,
    smooth_noise,
    training_cells,
)


def test_mirror_twins_share_a_group(scene: Scene, reference: TransportTable) -> None:
    group = training_cells(scene, [reference]).group
    twins = group[:, mirror_twins(scene).twin]
    sides = np.array([0, 1, 2, 5, 6, 7])
    tips = np.array([3, 4])
    np.testing.assert_array_equal(group[:, sides], twins[:, sides])
    np.testing.assert_array_equal(group[:, tips], twins[::-1][:, tips])
    assert group.max() + 1 == group.size // 2


def test_every_fold_holds_whole_groups_of_nearly_equal_number() -> None:
    group = np.repeat(np.arange(53), 4).reshape(53, 2, 2)
    fold = folds(group, 5, seed=1)
    assert (fold == fold[:, :1, :1]).all()
    assert np.ptp(np.bincount(fold.ravel())) <= 4
    assert not np.array_equal(fold, folds(group, 5, seed=2))


def test_inner_folds_never_hold_out_the_ends() -> None:
    group = np.tile(np.arange(7), (2, 1))
    fold = interior_folds(group, 3, seed=0, inner=True)
    assert (fold[:, [0, -1]] == -1).all()
    assert set(fold[0, 1:-1]) == {0, 1, 2}


def test_a_table_of_another_size_is_refused(
    make_scene: Callable[..., Scene], reference: TransportTable
) -> None:
    other = make_scene(fibers={"left": 2, "right": 2})
    with pytest.raises(TableError, match=r"\(8, 6, 6\), allowed: \(6, 6, 6\)"):
        training_cells(other, [reference])


def test_a_table_without_background_is_refused(scene: Scene, reference: TransportTable) -> None:
    with pytest.raises(TableError, match="no background"):
        training_cells(scene, [replace(reference, background=None)])


def test_a_table_that_does_not_name_its_bends_is_refused(
    scene: Scene, reference: TransportTable
) -> None:
    with pytest.raises(TableError, match="0 bends for 5"):
        training_cells(scene, [replace(reference, bends=np.zeros(0))])


def test_the_ratio_is_reference_over_preview(
    scene: Scene, grid: PreviewGrid, reference: TransportTable
) -> None:
    cells = training_cells(scene, [reference])
    rows = build_rows(scene, grid, cells)
    ratio = rows.ratio.numpy().reshape(cells.transport.shape)
    preview = np.exp(grid.log_transport).swapaxes(0, 1)
    np.testing.assert_allclose(ratio, cells.transport / preview, rtol=1e-4)


def test_the_smoothed_noise_is_the_true_one_though_error_bars_scatter() -> None:
    rng = np.random.default_rng(0)
    x = rng.normal(size=(4000, 2))
    truth = 0.1 * np.exp(0.5 * x[:, :1]) * np.ones((1, 3))
    value = np.exp(rng.normal(size=truth.shape))
    bars = value * truth * np.sqrt(rng.chisquare(7, truth.shape) / 7)
    smooth = smooth_noise(value, bars, x)
    np.testing.assert_allclose(smooth, truth, rtol=0.12)


def test_an_exact_reference_has_no_noise() -> None:
    assert (smooth_noise(np.ones((5, 2)), np.zeros((5, 2)), np.ones((5, 1))) == 0).all()
