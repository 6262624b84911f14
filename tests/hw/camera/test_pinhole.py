"""Which way a tilt turns the camera."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hw.camera.pinhole import rotation

TILT = (0.1, -0.2, 0.3)


def test_turns_are_right_handed_about_x_and_z_and_left_handed_about_y() -> None:
    about_x, about_y, about_z = TILT
    wanted = Rotation.from_euler("xyz", [about_x, -about_y, about_z]).as_matrix()
    np.testing.assert_allclose(rotation(TILT), wanted, atol=1e-15)


@pytest.mark.parametrize("axis", [0, 1])
def test_a_tilt_leads_the_optical_axis_sideways_by_its_own_angle(axis: int) -> None:
    ahead = rotation(np.eye(3)[axis] * 0.1) @ [0.0, 0.0, 1.0]
    sideways = -np.sin(0.1) * np.eye(3)[1 - axis]
    np.testing.assert_allclose(ahead, [*sideways[:2], np.cos(0.1)], atol=1e-15)


def test_turning_back_is_the_inverse() -> None:
    turn = rotation(TILT)
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
