"""Convex bodies pressed into the pad: the pyramids of the metric; a bolt, a ball, a file for eyes.

A body is the intersection of half-spaces that the coating's plane cuts; its frame is that of the
untouched pad at its center: across, towards the tip, towards the coating. It follows the bend.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from render.arrays import Array
from render.errors import SceneError
from render.geometry.layout import declared_sites, facet_normals, pyramid
from render.scene import Scene

if TYPE_CHECKING:
    import trimesh

SHADOW_LENGTH = 4.0
"""How far from its center a body's shadow is drawn, in units of its radius or its depth."""
DRAPE = np.pi / 3
"""Slope of the skin around a body with steeper walls, rad; skin does not follow upright ones."""
DRAPE_FACES, MAX_FACES, BALL_RINGS = 48, 48, 5
"""Faces around the body of a file, and of its end, at most; rings of a ball's faces."""
FILE_DEPTH = 1.0
"""How far the body of a file is pressed in at most, mm."""


@dataclass(frozen=True, eq=False)
class Imprint:
    """The same body pressed into a grid of places.

    Arguments:
        center: of each body on the flat coating, ``(site, 3)`` mm, row by row.
        columns, rows, spacing: of the grid; spacing in mm.
        normal: of each face, ``(face, 3)``, unit vectors out of the body and into the pad.
        distance: of the faces' planes from the center, ``(face,)`` mm along their normals.
        middle: a point of each face, ``(face, 3)`` mm from the center.
        size: the larger one of radius and depth, mm.
    """

    center: Array
    columns: int
    rows: int
    spacing: float
    normal: Array
    distance: Array
    middle: Array
    size: float


def pyramids(scene: Scene) -> Imprint:
    """Return the indenter at every site."""
    normal, corners = facet_normals(scene), pyramid(scene)
    return Imprint(
        center=declared_sites(scene),
        columns=scene.sites.columns,
        rows=scene.sites.rows,
        spacing=scene.sites.spacing,
        normal=normal,
        distance=np.einsum("ki,ki->k", normal, corners[:, 0]),
        middle=corners.mean(axis=1),
        size=max(scene.indenter.radius, scene.indenter.depth),
    )


@dataclass(frozen=True)
class BoltHead:
    """A hexagonal bolt head, pressed in head first; the defaults are an M3 (ISO 4017).

    Arguments:
        radius: over the corners, mm; depth: how far it is pressed in, mm.
        drape: slope of the skin around the head, rad; skin does not follow upright walls.
        chamfer: slope of the cone that breaks the corners of the head's end, rad.
    """

    radius: float = 3.0
    depth: float = 1.0
    drape: float = DRAPE
    chamfer: float = np.pi / 6

    @property
    def imprint_radius(self) -> float:
        """Radius of the imprint in the coating's plane, over the corners, mm."""
        flats = self.radius * np.cos(np.pi / 6) + self.depth / np.tan(self.drape)
        return float(flats / np.cos(np.pi / 6))


def bolt(scene: Scene, head: BoltHead | None = None) -> Imprint:
    """Return a bolt at the row of sites nearest to the base, in the middle (thesis 5.4).

    Raises:
        SceneError: the pad is too small or too thin for it.
    """
    head = head or BoltHead()
    reach = np.full(2, head.imprint_radius)
    center = _place(scene, "a bolt", reach, head.depth, declared_sites(scene)[:, 1].min())
    flats, down = head.radius * np.cos(np.pi / 6), np.array([0.0, 0.0, -head.depth])
    half = 0.5 * head.depth
    sides = _cone(6, np.pi / 6, flats + half / np.tan(head.drape), head.drape, -half)
    # The cone meets the end a little inside the flats, as turned bolts do.
    edges = _cone(12, 0.0, 0.95 * flats, head.chamfer, -head.depth)
    normal = np.concatenate([[[0.0, 0.0, -1.0]], sides[0], edges[0]])
    distance = np.concatenate([[head.depth], sides[1], edges[1]])
    middle = np.concatenate([[down], sides[2], edges[2]])
    return _single(center, normal, distance, middle, max(head.imprint_radius, head.depth))


def ball(scene: Scene, radius: float = 3.0, depth: float = 1.0) -> Imprint:
    """Return a ball in the middle of the sites: planes that touch it, in rings of equal slopes.

    Arguments:
        scene: the sensor.
        radius: of the ball, mm.
        depth: how far it is pressed in, mm; less than the radius.

    Raises:
        SceneError: the pad is too small or too thin for it.
    """
    reach = np.sqrt(radius**2 - (radius - depth) ** 2)
    center = _place(scene, "a ball", np.full(2, reach), depth, declared_sites(scene)[:, 1].mean())
    steepest = np.arccos(1.0 - depth / radius)
    rings = [
        _cone(
            8 + 4 * i, 0.0, radius * np.sin(slope), slope, radius - depth - radius * np.cos(slope)
        )
        for i, slope in enumerate(np.linspace(0.0, steepest, BALL_RINGS + 1)[1:])
    ]
    end = np.array([[0.0, 0.0, -1.0]]), np.array([depth]), np.array([[0.0, 0.0, -depth]])
    normal, distance, middle = (np.concatenate(part) for part in zip(end, *rings, strict=True))
    return _single(center, normal, distance, middle, max(reach, depth))


def body_of_file(scene: Scene, path: Path) -> Imprint:
    """Return the convex hull of the body in a mesh file (STL, PLY, OBJ; mm), its lower end pressed.

    It is pressed 1 mm deep, or a quarter of the pad, in the middle of the sites. Skin does not
    follow walls that are steeper than DRAPE.

    Raises:
        SceneError: the file is no body, or the pad is too small for it.
    """
    # A robot has no trimesh, and presses no file.
    import trimesh

    try:
        mesh = trimesh.load_mesh(path)
        points = np.asarray(mesh.convex_hull.vertices, dtype=np.float64)
    except Exception as error:  # readers and qhull raise what they like
        raise SceneError(
            f"{path} is no body that can be pressed in ({type(error).__name__}), allowed: a mesh "
            "file in mm, such as STL, PLY or OBJ",
            field="press",
        ) from None
    depth = min(FILE_DEPTH, 0.25 * scene.pad.thickness, float(np.ptp(points[:, 2])))
    if depth <= 0.0:
        raise SceneError(f"{path} is flat, allowed: a body with a volume", field="press")
    low, high = points.min(axis=0), points.max(axis=0)
    points = points - [*(0.5 * (low + high))[:2], low[2] + depth]
    hull = trimesh.convex.convex_hull(points)
    wet = _below(hull)
    facing = hull.facets_normal if len(hull.facets_normal) else np.zeros((0, 3))
    facing = np.concatenate([facing, hull.face_normals])
    facing = np.unique(np.round(facing, 3), axis=0)
    facing /= np.linalg.norm(facing, axis=1, keepdims=True)
    gentle = facing[facing[:, 2] <= -np.cos(DRAPE)]
    if len(gentle) > MAX_FACES:
        gentle = _directions(MAX_FACES)
    steep = facing[np.abs(facing[:, 2]) < np.cos(DRAPE)]
    turn = 2 * np.pi / DRAPE_FACES
    azimuth = turn * np.arange(DRAPE_FACES)
    if len(steep):
        azimuth = turn * np.unique(np.round(np.arctan2(steep[:, 0], steep[:, 1]) / turn))
    side = np.stack([np.sin(azimuth), np.cos(azimuth), np.zeros(len(azimuth))], axis=-1)
    normal = np.concatenate([gentle, np.sin(DRAPE) * side - [0.0, 0.0, np.cos(DRAPE)]])
    along = wet @ normal.T
    distance = along.max(axis=0)
    touching = along > distance - 1e-6
    middle = (touching.T @ wet) / touching.sum(axis=0)[:, None]
    half = np.abs(wet[:, :2]).max(axis=0) + depth / np.tan(DRAPE)
    center = _place(scene, str(path), half, depth, declared_sites(scene)[:, 1].mean())
    return _single(center, normal, distance, middle, max(*half, depth))


def _below(hull: trimesh.Trimesh) -> Array:
    """Return the corners ``(n, 3)`` of the part of a convex body that lies below z = 0."""
    points, edges = hull.vertices, hull.edges_unique
    first, second = points[edges[:, 0]], points[edges[:, 1]]
    crossing = first[:, 2] * second[:, 2] < 0
    first, second = first[crossing], second[crossing]
    part = first[:, 2:] / (first[:, 2:] - second[:, 2:])
    return np.concatenate([points[points[:, 2] <= 0], first + part * (second - first)])


def imprint_depth(imprint: Imprint, x: Array, y: Array) -> Array:
    """Return how deep the skin is pressed in at flat places ``x, y`` (mm), in mm; 0 beside it."""
    depth = np.zeros(np.broadcast(x, y).shape)
    for center in imprint.center:
        offset = np.stack(np.broadcast_arrays(x - center[0], y - center[1]), axis=-1)
        lowest = np.full(depth.shape, np.inf)
        for normal, distance in zip(imprint.normal, imprint.distance, strict=True):
            lowest = np.minimum(lowest, (distance - offset @ normal[:2]) / -normal[2])
        depth = np.maximum(depth, lowest)
    return depth


def _directions(count: int) -> Array:
    """Return ``count`` unit vectors, downward, evenly spread over slopes below DRAPE."""
    number = np.arange(count) + 0.5
    height = 1.0 - number / count * (1.0 - np.cos(DRAPE))
    angle = np.pi * (1.0 + np.sqrt(5.0)) * number
    flat = np.sqrt(1.0 - height**2)
    return np.stack([flat * np.sin(angle), flat * np.cos(angle), -height], axis=-1)


def _place(scene: Scene, name: str, half: Array, depth: float, y: float) -> Array:
    """Return the flat position of a body that reaches ``half`` ``(2,)`` mm, near ``y``.

    Raises:
        SceneError: the pad is too small or too thin for it.
    """
    pad = scene.pad
    room = np.array([pad.width / 2, pad.length / 2]) - half
    if room.min() < 0 or depth >= pad.thickness:
        raise SceneError(
            f"{name} of {2 * half[0]:.3g} x {2 * half[1]:.3g} mm pressed {depth:g} mm deep does "
            f"not fit into the pad of {pad.width:g} x {pad.length:g} x {pad.thickness:g} mm",
            field="pad",
        )
    wanted = np.array([declared_sites(scene)[:, 0].mean(), y])
    return np.append(np.clip(wanted, -room, room), pad.thickness)


def _single(center: Array, normal: Array, distance: Array, middle: Array, size: float) -> Imprint:
    return Imprint(
        center=center[None],
        columns=1,
        rows=1,
        spacing=1.0,
        normal=normal,
        distance=distance,
        middle=middle,
        size=float(size),
    )


def _cone(
    faces: int, first: float, radius: float, slope: float, height: float
) -> tuple[Array, Array, Array]:
    """Return normals, distances and touching points of planes around an upright axis.

    Each touches the circle of ``radius`` at ``height`` and slopes by ``slope`` from the horizontal;
    the first one's azimuth is ``first``.
    """
    azimuth = first + 2 * np.pi * np.arange(faces) / faces
    outward = np.stack([np.sin(azimuth), np.cos(azimuth), np.zeros(faces)], axis=-1)
    normal = np.sin(slope) * outward - [0.0, 0.0, np.cos(slope)]
    touch = radius * outward + [0.0, 0.0, height]
    return normal, np.einsum("ki,ki->k", normal, touch), touch
