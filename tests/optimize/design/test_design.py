"""Designs: what is refused, and the baseline."""

from __future__ import annotations

import numpy as np
import pytest

from optimize.design import Design, baseline_design
from render.errors import DesignError
from render.scene import load_scene


def test_the_baseline_has_one_color_per_edge_and_points_inwards() -> None:
    design = baseline_design(load_scene("finger20"))
    assert design.color_names == ["red"] * 8 + ["blue"] * 4 + ["green"] * 8
    np.testing.assert_array_equal(design.phi, np.full(20, np.pi / 2))
    np.testing.assert_array_equal(design.power.sum(axis=1), np.ones(20))


def test_a_fiber_without_power_is_off() -> None:
    design = Design(np.zeros(2), np.array([[0.0, 0.0, 0.0], [0.2, 0.5, 0.1]]))
    assert design.color_names == ["off", "green"]


def test_one_color_is_a_fault_where_there_are_several_lamps() -> None:
    assert Design.of_colors(np.zeros(2), [1, 1]).monochrome
    assert not Design.of_colors(np.zeros(1), [1]).monochrome


@pytest.mark.parametrize("angle", [-0.01, 3.15, np.nan, np.inf])
def test_directions_outside_the_half_turn_are_refused(angle: float) -> None:
    with pytest.raises(DesignError, match=r"phi\[1\] = .*allowed: 0 to pi rad"):
        Design.of_colors(np.array([0.0, angle]), [0, 1])


def test_powers_outside_0_to_1_are_refused() -> None:
    with pytest.raises(DesignError, match=r"power\[1, 2\] = 1.5, allowed: 0 to 1"):
        Design(np.zeros(2), np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.5]]))


def test_wrong_shapes_and_unknown_colors_are_refused() -> None:
    with pytest.raises(DesignError, match="power has shape"):
        Design(np.zeros(3), np.eye(3)[:2])
    with pytest.raises(DesignError, match="phi has shape"):
        Design(np.zeros((3, 1)), np.eye(3))
    with pytest.raises(DesignError, match="allowed: one of 0, 1, 2"):
        Design.of_colors(np.zeros(2), [0, 3])
