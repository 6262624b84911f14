"""Reference lines in the pad's frame and in that of a fiber."""

from __future__ import annotations

import numpy as np

from hw.calibration.reference_lines import frame_positions, in_frame, reference_lines
from render.scene import load_scene


def test_the_frame_is_that_of_the_reference_lines() -> None:
    scene = load_scene("finger20")
    lines = reference_lines(scene)
    for fiber in (0, 9, 15):
        np.testing.assert_allclose(
            in_frame(scene, fiber, lines.position[fiber]), frame_positions(), atol=1e-12
        )
