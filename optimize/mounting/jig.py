"""A drilling jig: one piece around the lit edges with a hole for every fiber, at its angle.

The jig is the holder of `render.geometry.FiberHolder` with a height: walls along the left, tip and
right edge, joined by miters at the corners. Its inner faces go through the fiber ends, so a fiber
that is pushed in until the center of its end is flush lies where the design wants it.

Every wall is cut into cells of one hole each. A hole is a cylinder and its cell lies between two
planes, so both are known from where they meet the inner and the outer face of the wall: the mesh
needs no boolean operations and closes by construction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from optimize.design import Design
from render.arrays import Array
from render.errors import TactiluxError
from render.geometry import (
    ALONG,
    PLAY,
    FiberHolder,
    FiberPoses,
    fiber_edges,
    flat_fiber_poses,
)
from render.scene import RIM_EDGES, Scene

MARGIN = 1.5
"""mm of wall above, below and beyond the holes."""
SIDES = 48
"""Of the polygon that stands for a circle; its area is 0.3 % too small."""


class JigError(TactiluxError):
    """A design whose holes do not fit into a jig."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """A closed surface: ``vertices`` ``(V, 3)`` mm and ``triangles`` ``(T, 3)``, outside left."""

    vertices: Array
    triangles: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class _Plan:
    """The jig from above: borders of its cells, and the holes between them.

    Arguments:
        borders: ``(cell + 1, 2, 2)`` mm, where each border meets the inner and the outer face.
        holes: per cell, ``(2, SIDES, 3)`` where the hole meets both faces; None without a hole.
    """

    borders: Array
    holes: list[Array | None]


def drilling_jig(scene: Scene, design: Design) -> Mesh:
    """Return the jig for ``design``; mm in the flat pad frame.

    Raises:
        JigError: holes would meet each other, a corner or an end of the jig; it says which.
    """
    holder, poses, fibers = FiberHolder.of(scene), flat_fiber_poses(scene), scene.fibers
    if fibers is None or scene.lamps:
        raise JigError(
            "there is no jig for lamps in rows and lists of their own, only for fibers: take their "
            "places from the board drawing",
            field="rows",
        )
    for problem in holder.problems(design.phi):
        raise JigError(
            f"there is no jig for this design: {problem}; explore anew, or round less",
            field="angles_deg",
        )
    holes = _holes(poses, poses.directions(design.phi), fibers.diameter, holder.thickness)
    plan = _plan(scene, holes, holder.thickness, fibers.gap)
    heights = holes[..., 2].min() - MARGIN, holes[..., 2].max() + MARGIN
    return _closed(plan, *heights)


def _holes(poses: FiberPoses, beams: Array, diameter: float, thickness: float) -> Array:
    """Return where holes meet the inner and the outer face, ``(fiber, 2, SIDES, 3)`` mm.

    Corners go counterclockwise as one looks at the wall from the pad.
    """
    turn = 2 * np.pi * np.arange(SIDES) / SIDES
    level = np.cross(poses.up, poses.inward)  # the way in which fibers are numbered
    first = level - (level * beams).sum(axis=1, keepdims=True) * beams
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(beams, first)
    ring = (
        (diameter + PLAY)
        / 2
        * (np.cos(turn)[:, None] * first[:, None] + np.sin(turn)[:, None] * second[:, None])
    )
    inside = np.einsum("fkx,fx->fk", ring, poses.inward)
    slope = (beams * poses.inward).sum(axis=1)[:, None]
    faces = [
        poses.position[:, None] + ring - ((inside + depth) / slope)[..., None] * beams[:, None]
        for depth in (0.0, thickness)
    ]
    return np.stack(faces, axis=1)


def _plan(scene: Scene, holes: Array, thickness: float, gap: float) -> _Plan:
    """Cut the walls into cells of one hole each; ``gap`` is that of the fibers."""
    edge_of = fiber_edges(scene)
    left, tip, right, _ = (rim + gap for rim in scene.box.rims)
    x, y = scene.pad.width / 2, scene.pad.length / 2
    faces = np.array([-x - left, y + tip, x + right])
    outwards = thickness * np.array([-1.0, 1.0, 1.0])
    base = min(-scene.pad.length / 2, float(holes[..., 1].min()) - MARGIN)
    # Corners of the inner and of the outer face, in the order of the fibers.
    corners = np.array(
        [[(a, base), (a, b), (c, b), (c, base)] for a, b, c in (faces, faces + outwards)]
    ).swapaxes(0, 1)
    borders, cells = [corners[0]], []
    for edge, start, end in zip(RIM_EDGES, corners[:-1], corners[1:], strict=True):
        own = [i for i, name in enumerate(edge_of) if name == edge]
        along = ALONG[edge]
        reach = [(holes[i, ..., :2] @ along) for i in own]  # (2, SIDES) each
        for place, fiber in enumerate(own):
            last = place == len(own) - 1
            after = end @ along
            if not last:
                after = (reach[place].max(axis=1) + reach[place + 1].min(axis=1)) / 2
            across = start - np.outer(start @ along, along)
            borders.append(end if last else across + np.outer(after, along))
            cells.append(holes[fiber])
        if not own:
            borders.append(end)
            cells.append(None)
    return _Plan(np.array(borders), cells)


def _closed(plan: _Plan, low: float, high: float) -> Mesh:
    """Return the closed mesh of a plan between two heights."""
    count = len(plan.borders)
    # Vertex of border j, face (inner, outer), height (low, high): 4 j + 2 face + height.
    flat = np.repeat(plan.borders.reshape(-1, 2), 2, axis=0)
    vertices = [np.column_stack([flat, np.tile([low, high], 2 * count)])]
    triangles: list[tuple[int, int, int]] = []

    def quad(a: int, b: int, c: int, d: int) -> None:
        triangles.extend([(a, b, c), (a, c, d)])

    free = 4 * count
    for j, hole in enumerate(plan.holes):
        a, b = 4 * j, 4 * (j + 1)
        quad(a + 1, b + 1, b + 3, a + 3)  # above
        quad(a, a + 2, b + 2, b)  # below
        inner, outer = [a, b, b + 1, a + 1], [a + 2, b + 2, b + 3, a + 3]
        if hole is None:
            quad(*inner)
            quad(*outer[::-1])
            continue
        vertices.append(hole.reshape(-1, 3))
        way = plan.borders[j + 1] - plan.borders[j]
        rings = [np.arange(SIDES) + free + face * SIDES for face in (0, 1)]
        for face, (frame, ring) in enumerate(zip((inner, outer), rings, strict=True)):
            along = hole[face, :, :2] @ way[face]
            around = _around(frame, ring, along, hole[face, :, 2])
            triangles += around if face == 0 else [(a, c, b) for a, b, c in around]
        for k in range(SIDES):
            near, after = rings[0][[k, (k + 1) % SIDES]].tolist()
            far, beyond = rings[1][[k, (k + 1) % SIDES]].tolist()
            quad(near, after, beyond, far)
        free += 2 * SIDES
    quad(0, 1, 3, 2)
    end = 4 * (count - 1)
    quad(end, end + 2, end + 3, end + 1)
    return Mesh(np.concatenate(vertices), np.array(triangles, dtype=np.int64))


def _around(
    frame: list[int], ring: NDArray[np.int64], along: Array, height: Array
) -> list[tuple[int, int, int]]:
    """Return triangles between a rectangle and a convex hole in it, counterclockwise.

    Every corner of ``frame`` (from below left, counterclockwise) sees the quarter of ``ring``
    between the hole's outermost points on its two sides.
    """
    outermost = [along.argmin(), height.argmin(), along.argmax(), height.argmax()]
    triangles = []
    for side, corner in enumerate(frame):
        first, last = int(outermost[side]), int(outermost[(side + 1) % 4])
        for k in range(first, first + (last - first) % SIDES):
            a, b = int(ring[k % SIDES]), int(ring[(k + 1) % SIDES])
            triangles.append((corner, b, a))
        triangles.append((corner, frame[(side + 1) % 4], int(ring[last])))
    return triangles


def stl_bytes(mesh: Mesh) -> bytes:
    """Return the mesh as a binary STL file, mm."""
    corners = mesh.vertices[mesh.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    record = np.zeros(len(corners), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)),
                                           ("attribute", "<u2")])  # fmt: skip
    record["normal"], record["corners"] = normals, corners
    header = b"tactilux drilling jig, mm".ljust(80)
    return header + np.array(len(corners), dtype="<u4").tobytes() + record.tobytes()
