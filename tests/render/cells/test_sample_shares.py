"""Samples are shared as asked for, over a floor; near fibers get more of them by default."""

from __future__ import annotations

import numpy as np
import pytest

from render.cells.sample_shares import FLOOR, SLOTS, floored_shares, near_slots, pad_slots
from render.scene import load_scene

SITE = np.array([[0.0, 0.0, 4.0], [5.0, 0.0, 4.0]])
FIBER = np.array([[-10.0, 0.0, 2.0], [10.0, 0.0, 2.0], [0.0, 20.0, 2.0]])


def test_every_fiber_has_slots_and_near_ones_more() -> None:
    found = near_slots(SITE, FIBER)
    assert found.sum(axis=1).tolist() == [SLOTS, SLOTS]
    assert (found > 0).all()
    assert found[1, 1] > found[1, 0] > found[1, 2]


@pytest.mark.parametrize(("sites", "fibers"), [(15, 20), (1, 1), (3, 700)])
def test_slots_follow_the_shares_to_rounding_and_leave_nothing_out(sites: int, fibers: int) -> None:
    shares = np.random.default_rng(sites).gamma(0.3, size=(sites, fibers))
    shares[0, 0] = 1e-12
    slots = pad_slots(shares)
    assert slots.sum() % SLOTS == 0
    assert slots.min() >= 1
    exact = shares / shares.sum() * slots.sum()
    # Those raised to one slot take theirs from the others, one each.
    assert np.abs(slots - exact)[exact >= 2].max() <= 2.0


def test_the_floor_is_a_part_of_the_usual_shares_whatever_is_asked_for() -> None:
    scene = load_scene("finger20")
    bends, shape = np.radians([0.0, 90.0]), (2, 15, 20)
    usual = floored_shares(scene, bends, np.zeros(shape))
    np.testing.assert_allclose(usual.sum(axis=(1, 2)), 0.5)
    wanted = np.zeros(shape)
    wanted[1, 3, 7] = 5.0
    found = floored_shares(scene, bends, wanted)
    np.testing.assert_allclose(found - FLOOR * usual, (1.0 - FLOOR) * wanted / 5.0, atol=1e-15)
