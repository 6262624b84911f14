"""The scene's pinhole in OpenCV's form, and turning it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from render.arrays import Array
from render.scene import Scene


def rotation(tilt: Sequence[float]) -> Array:
    """Return the matrix that turns by ``tilt`` (rad) about x, then y, then the viewing axis.

    Every turn leads the first of the other two axes towards the second, in the order x, y, z.
    About x (y to z) and z (x to y) that is right-handed; about y (x to z) it is left-handed, so
    that the same sign of the first two tilts moves the picture the same way along both its axes.
    """
    turns = []
    for axis, angle in enumerate(tilt):
        turn = np.eye(3)
        a, b = [i for i in range(3) if i != axis]
        turn[a, a] = turn[b, b] = np.cos(angle)
        turn[a, b], turn[b, a] = -np.sin(angle), np.sin(angle)
        turns.append(turn)
    return np.asarray(turns[2] @ turns[1] @ turns[0])


def intrinsics(scene: Scene, columns: int, rows: int) -> Array:
    """Return the pinhole matrix ``(3, 3)`` of the scene's camera in OpenCV's form.

    Positions count from the middle of the first pixel; the field of view spans all rows.
    """
    focal = 0.5 * rows / np.tan(scene.camera.field_of_view / 2)
    return np.array(
        [[focal, 0.0, 0.5 * columns - 0.5], [0.0, focal, 0.5 * rows - 0.5], [0.0, 0.0, 1.0]]
    )
