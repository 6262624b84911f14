"""Training cells and their groups."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from render.errors import TableError
from render.geometry.layout import mirrored_fibers
from render.scene.schema import Scene
from render.transport import TransportTable
from surrogate.training.dataset import cells_from_table, folds, interior_folds


def test_mirror_twins_share_a_group(scene: Scene, reference: TransportTable) -> None:
    group = cells_from_table(scene, reference).group
    twins = group[:, mirrored_fibers(scene)]
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
        cells_from_table(other, reference)


def test_a_table_without_background_is_refused(scene: Scene, reference: TransportTable) -> None:
    with pytest.raises(TableError, match="no background"):
        cells_from_table(scene, replace(reference, background=None))


def test_a_table_that_does_not_name_its_bends_is_refused(
    scene: Scene, reference: TransportTable
) -> None:
    with pytest.raises(TableError, match="0 bends for 5"):
        cells_from_table(scene, replace(reference, bends=np.zeros(0)))
