"""Exact derivatives of objectives held against differences of their values."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from optimize.design import Design
from optimize.search import Objective

STEP, NEAR = 1e-5, 1e-5


def assert_slopes_are_differences(
    goal: Objective, design: Design, rng: np.random.Generator
) -> None:
    """Hold the gradient of ``goal`` against steps along a random direction and a random power."""
    value, by_phi, by_power = goal.gradient(design)
    assert value == pytest.approx(goal.value(design))
    turn = STEP * rng.standard_normal(len(design.phi))
    up, down = (goal.value(replace(design, phi=design.phi + s * turn)) for s in (1, -1))
    assert 2.0 * (by_phi @ turn) == pytest.approx(up - down, rel=NEAR)
    step = STEP * rng.standard_normal(design.drive.shape) * (design.drive > 0)
    up, down = (goal.value(replace(design, drive=design.drive + s * step)) for s in (1, -1))
    assert 2.0 * (by_power * step).sum() == pytest.approx(up - down, rel=NEAR)
