"""Samples go to the fibers that are asked for, and near ones get more of them."""

from __future__ import annotations

import numpy as np
import pytest

pytestmark = pytest.mark.usefixtures("mono")
SITE = np.array([[0.0, 0.0, 4.0], [5.0, 0.0, 4.0]])
FIBER = np.array([[-10.0, 0.0, 2.0], [10.0, 0.0, 2.0], [0.0, 20.0, 2.0]])


def shares(lit: np.ndarray | None = None) -> np.ndarray:
    """Return the part of the slots that each fiber has, ``(site, fiber)``."""
    from render.cells.cell_sampler import FIBER_SLOTS, fiber_slots

    slots = fiber_slots(SITE, FIBER, lit)
    return np.stack([np.bincount(row, minlength=3) for row in slots]) / FIBER_SLOTS


def test_every_fiber_has_slots_and_near_ones_more() -> None:
    found = shares()
    assert (found > 0).all()
    assert found[1, 1] > found[1, 0] > found[1, 2]
    np.testing.assert_allclose(found.sum(axis=1), 1.0)


def test_all_fibers_lit_is_the_default() -> None:
    np.testing.assert_array_equal(shares(np.ones((2, 3), dtype=bool)), shares())


def test_fibers_that_are_not_lit_get_no_slots() -> None:
    found = shares(np.array([[True, False, True], [False, True, False]]))
    assert found[0, 1] == 0
    assert found[0, [0, 2]].min() > 0
    assert found[1].tolist() == [0.0, 1.0, 0.0]


def test_a_site_without_lit_fibers_spreads_its_samples() -> None:
    lit = np.array([[False, False, False], [True, True, True]])
    np.testing.assert_array_equal(shares(lit), shares())
