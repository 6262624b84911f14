"""A drilling jig: one piece around the edges with a hole for every lit lamp, at its angle.

The jig is the holder of `render.geometry.FiberHolder` with a height: walls along the left, tip and
right edge, and along the base where lamps are, joined by miters at the corners. Its inner faces go
through the ends of lamps, so one that is pushed in until the center of its end is flush lies where
the design wants it.

Every wall is cut into cells of one hole each. A hole is a cylinder and its cell lies between two
planes, so both are known from where they meet the inner and the outer face of the wall: the mesh
needs no boolean operations and closes by construction.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from optimize.design import DARK, Design
from render.arrays import Array
from render.errors import TactiluxError
from render.geometry import (
    ALONG,
    PLAY,
    FiberHolder,
    FiberPoses,
    flat_fiber_poses,
)
from render.geometry.holder import LEAST_SINE
from render.scene import EDGES, RIM_EDGES, Scene
from render.scene.lamps import Edge

MARGIN = 1.5
"""mm of wall above, below and beyond the holes."""
FLUSH = 0.01
"""mm by which ends of one wall's lamps may be off its face."""
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
        borders: ``(border, 2, 2)`` mm, where each border meets the inner and the outer face; one
            more than cells, or as many where the walls are ``closed`` around the pad.
        holes: per cell, ``(2, SIDES, 3)`` where the hole meets both faces; None without a hole.
    """

    borders: Array
    holes: list[Array | None]
    closed: bool


def drilling_jig(scene: Scene, design: Design) -> Mesh:
    """Return the jig for the lamps that ``design`` lights; mm in the flat pad frame.

    Raises:
        JigError: a lamp is not beside an edge, those of an edge do not end in one plane, or holes
            would meet each other, a corner or an end of the jig; it says which.
    """
    holder, poses = FiberHolder.of(scene), flat_fiber_poses(scene)
    lit, beams = design.colors != DARK, poses.directions(design.phi)
    numbers = np.flatnonzero(lit)
    for lamp in numbers.tolist():
        for problem in _misfits(poses, beams, lamp):
            raise JigError(
                f"there is no jig for this design: lamp {lamp} {problem}; take places from the "
                "board drawing",
                field="positions",
            )
    gaps = _gaps(poses, numbers)
    for problem in holder.problems(design.phi, lit):
        raise JigError(
            f"there is no jig for this design: {problem}; explore anew, or round less",
            field="angles_deg",
        )
    holes = {int(i): _hole(poses, beams, int(i), holder.thickness) for i in numbers}
    plan = _plan(scene, holes, poses, holder.thickness, gaps)
    heights = [hole[..., 2] for hole in holes.values()]
    return _closed(plan, np.min(heights) - MARGIN, np.max(heights) + MARGIN)


def _misfits(poses: FiberPoses, beams: Array, lamp: int) -> Iterator[str]:
    """Yield why a lamp has no place in a wall."""
    if poses.face[lamp] >= len(EDGES):
        yield "sits below the pad, not beside an edge"
    elif poses.gap[lamp] < 0.0:
        yield "is cast into the silicone"
    elif beams[lamp] @ poses.face_inward[lamp] < LEAST_SINE:
        yield "shines along its wall"


def _gaps(poses: FiberPoses, numbers: NDArray[np.int64]) -> dict[Edge, float]:
    """Return the distance (mm) of each edge's wall: that of its lamps, or else the least of all.

    Raises:
        JigError: lamps of an edge have several, or none is lit.
    """
    if not len(numbers):
        raise JigError("there is no jig for this design: it lights no lamp", field="power")
    gaps = dict.fromkeys(EDGES, float(poses.gap[numbers].min()))
    for number, edge in enumerate(EDGES):
        own = poses.gap[numbers[poses.face[numbers] == number]]
        if len(own) and np.ptp(own) > FLUSH:
            raise JigError(
                f"there is no jig for this design: lamps of the {edge} edge end {own.min():g} and "
                f"{own.max():g} mm from the pad, needed: one distance; take places from the board "
                "drawing",
                field="positions",
            )
        gaps[edge] = float(own[0]) if len(own) else gaps[edge]
    return gaps


def _hole(poses: FiberPoses, beams: Array, lamp: int, thickness: float) -> Array:
    """Return where the hole of a lamp meets the inner and the outer face, ``(2, SIDES, 3)`` mm.

    Corners go counterclockwise as one looks at the wall from the pad.
    """
    turn = 2 * np.pi * np.arange(SIDES) / SIDES
    inward, beam = poses.face_inward[lamp], beams[lamp]
    level = np.cross([0.0, 0.0, 1.0], inward)  # the way in which fibers are numbered
    first = level - (level @ beam) * beam
    first /= np.linalg.norm(first)
    radius = poses.radius[lamp] + PLAY / 2
    around = np.cos(turn)[:, None] * first + np.sin(turn)[:, None] * np.cross(beam, first)
    ring = radius * around
    depths = [(ring @ inward + depth) / (beam @ inward) for depth in (0.0, thickness)]
    return np.stack([poses.position[lamp] + ring - depth[:, None] * beam for depth in depths])


def _plan(
    scene: Scene,
    holes: Mapping[int, Array],
    poses: FiberPoses,
    thickness: float,
    gaps: Mapping[Edge, float],
) -> _Plan:
    """Cut the walls into cells of one hole each.

    Raises:
        JigError: holes meet each other, a corner or an end.
    """
    edge_of = {lamp: EDGES[poses.face[lamp]] for lamp in holes}
    closed = "base" in edge_of.values()
    left, tip, right, below = (
        rim + gaps[edge] for rim, edge in zip(scene.box.rims, EDGES, strict=True)
    )
    x, y = scene.pad.width / 2, scene.pad.length / 2
    every = np.concatenate(list(holes.values()))
    base = -y - below if closed else min(-y, float(every[..., 1].min()) - MARGIN)
    faces = np.array([-x - left, y + tip, x + right, base])
    outwards = thickness * np.array([-1.0, 1.0, 1.0, -1.0 if closed else 0.0])
    # Corners of the inner and of the outer face, in the order of the fibers.
    corners = np.array(
        [[(a, d), (a, b), (c, b), (c, d), (a, d)] for a, b, c, d in (faces, faces + outwards)]
    ).swapaxes(0, 1)
    borders: list[Array] = [corners[0]]
    cells: list[Array | None] = []
    for number, edge in enumerate(EDGES if closed else RIM_EDGES):
        start, end, along = corners[number], corners[number + 1], ALONG[edge]
        own = [lamp for lamp, its in edge_of.items() if its == edge]
        own.sort(key=lambda lamp: float(poses.position[lamp, :2] @ along))
        reach = [holes[lamp][..., :2] @ along for lamp in own]  # (2, SIDES) each
        for place, lamp in enumerate(own):
            last = place == len(own) - 1
            after = end @ along
            if not last:
                after = (reach[place].max(axis=1) + reach[place + 1].min(axis=1)) / 2
            room = (reach[place].min(axis=1) - borders[-1] @ along).min()
            if min(room, (after - reach[place].max(axis=1)).min()) <= 0.0:
                raise JigError(
                    f"there is no jig for this design: the hole of lamp {lamp} meets another, or "
                    f"an end of the {edge} wall; take places from the board drawing",
                    field="positions",
                )
            across = start - np.outer(start @ along, along)
            borders.append(end if last else across + np.outer(after, along))
            cells.append(holes[lamp])
        if not own:
            borders.append(end)
            cells.append(None)
    return _Plan(np.array(borders[:-1] if closed else borders), cells, closed)


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
        before, after = j, (j + 1) % count
        a, b = 4 * before, 4 * after
        quad(a + 1, b + 1, b + 3, a + 3)  # above
        quad(a, a + 2, b + 2, b)  # below
        inner, outer = [a, b, b + 1, a + 1], [a + 2, b + 2, b + 3, a + 3]
        if hole is None:
            quad(*inner)
            quad(*outer[::-1])
            continue
        vertices.append(hole.reshape(-1, 3))
        way = plan.borders[after] - plan.borders[before]
        rings = [np.arange(SIDES) + free + face * SIDES for face in (0, 1)]
        for face, (frame, ring) in enumerate(zip((inner, outer), rings, strict=True)):
            along = hole[face, :, :2] @ way[face]
            around = _around(frame, ring, along, hole[face, :, 2])
            triangles += around if face == 0 else [(a, c, b) for a, b, c in around]
        for k in range(SIDES):
            near, next_ = rings[0][[k, (k + 1) % SIDES]].tolist()
            far, beyond = rings[1][[k, (k + 1) % SIDES]].tolist()
            quad(near, next_, beyond, far)
        free += 2 * SIDES
    if not plan.closed:
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
