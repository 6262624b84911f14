"""Plane faces of the silicone at one bend: where they are and what they do to light.

A flat block has five beside its coating, a window under it included. When it bends its walls left
and right stay planes; its ends turn, and its lower face becomes a row of plane strips, as in the
meshes of the pad (``render.geometry.meshes``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from render.arrays import Array
from render.geometry import bend_points
from render.geometry.meshes import pad_grid
from render.scene import FACES, OUTWARD, Finish, Scene


@dataclass(frozen=True, eq=False)
class PlaneFace:
    """A plane, or the strip of it that begins at a ``point`` and goes ``length`` mm ``along``.

    Arguments:
        number: of the face in `render.scene.FACES` that it is part of.
        finish: what lies on it, beside silicone of this ``index``.
        point, inward: ``(3,)`` one of its points, mm, and its unit normal into the silicone.
        along, length: ``(3,)`` unit vector and mm; a wall's is infinite, as others bound it.
    """

    number: int
    finish: Finish
    index: float
    point: Array
    inward: Array
    along: Array
    length: float = np.inf

    @property
    def is_mirror(self) -> bool:
        """Whether light finds images in it: a smooth boundary to the air, or metal."""
        return self.finish.metal is not None or (self.finish.smooth and self.index != 1.0)


def mirror_faces(scene: Scene) -> NDArray[np.bool_]:
    """Return which of `FACES` are mirrors, ``(5,)``: smooth boundaries to the air, and metal."""
    return np.array([face.is_mirror for face in walls(scene, FACES)])


def walls(scene: Scene, names: tuple[str, ...]) -> list[PlaneFace]:
    """Return faces of the flat block by their ``names``."""
    box, found = scene.box, []
    for name in names:
        number = FACES.index(name)
        outward = OUTWARD[number]
        corner = np.where(outward > 0, box.high, box.low)
        point = np.abs(outward) * corner
        index = scene.pad.index
        found.append(PlaneFace(number, scene.finishes[number], index, point, -outward, 0 * point))
    return found


def outline(scene: Scene, bend: float, indented: bool) -> list[PlaneFace]:
    """Return base, strips of the lower face and tip of the pad at ``bend`` rad, in this order."""
    y = pad_grid(scene, bend, indented).y
    corners = np.zeros((len(y) + 2, 3))
    corners[:, 1] = np.r_[y[0], y, y[-1]]
    corners[[0, -1], 2] = scene.pad.thickness
    corners = bend_points(scene, corners, bend)
    span = np.diff(corners, axis=0)
    length = np.linalg.norm(span, axis=1)
    names = ["base", *["lower"] * (len(y) - 1), "tip"]
    found = []
    # The pad is on the left of the way along them.
    for name, point, way, size in zip(names, corners, span, length, strict=False):
        number, along = FACES.index(name), way / size
        inward = np.array([0.0, -along[2], along[1]])
        finish, index = scene.finishes[number], scene.pad.index
        found.append(PlaneFace(number, finish, index, point, inward, along, float(size)))
    return found


def plane_faces(scene: Scene, bend: float, indented: bool) -> list[list[PlaneFace]]:
    """Return the faces but the coating at ``bend`` rad, in groups at right angles to each other.

    Those of one group face each other, or are neighbors. ``indented`` pads have more strips.
    """
    sides = walls(scene, ("left", "right"))
    if bend == 0.0:
        return [sides, walls(scene, ("base", "tip")), walls(scene, ("lower",))]
    return [sides, outline(scene, bend, indented)]
