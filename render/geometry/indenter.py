"""Convex bodies pressed into the pad: the pyramids of the metric; a bolt, ball or edge for eyes.

A body is the intersection of half-spaces that the coating's plane cuts; its frame is that of the
untouched pad at its center: across, towards the tip, towards the coating. It follows the bend.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from render.arrays import Array
from render.errors import SceneError
from render.geometry.chart import SkinChart
from render.geometry.height_map import HeightMap, map_lines
from render.geometry.layout import declared_sites, facet_normals, pyramid, site_frames
from render.scene import Scene

SHADOW_LENGTH = 4.0
"""How far from its center a body's shadow is drawn, in units of its radius or its depth."""
DRAPE = np.pi / 3
"""Slope of the skin around a body with steeper walls, rad; skin does not follow upright ones."""
UPRIGHT = 1e-3
"""Least downward part of the normal of a face that skin lies on."""
BALL_RINGS = 5
"""Rings of a ball's faces."""
EDGE_SLOPE, EDGE_LENGTH = np.pi / 4, 8.0
"""Slope of both faces of a straight edge, rad: a corner of 90 degrees; its length in mm, or half of
the pad's width."""


@dataclass(frozen=True, eq=False)
class Imprint:
    """The same body pressed into a grid of places.

    Arguments:
        center: of each body on the skin of the flat block, ``(site, 3)`` mm, row by row.
        turn: ``(site, 3, 3)`` the rotation from each body's frame to that of the block.
        columns, rows, spacing: of the grid; spacing in mm.
        normal: of each face, ``(face, 3)``, unit vectors out of the body and into the pad.
        distance: of the faces' planes from the center, ``(face,)`` mm along their normals.
        middle: a point of each face, ``(face, 3)`` mm from the center.
        size: the larger one of radius and depth, mm.
    """

    center: Array
    turn: Array
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
        turn=site_frames(scene, 0.0),
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
    center = place_body(scene, "a bolt", reach, head.depth, declared_sites(scene)[:, 1].min())
    flats, down = head.radius * np.cos(np.pi / 6), np.array([0.0, 0.0, -head.depth])
    half = 0.5 * head.depth
    sides = _cone(6, np.pi / 6, flats + half / np.tan(head.drape), head.drape, -half)
    # The cone meets the end a little inside the flats, as turned bolts do.
    edges = _cone(12, 0.0, 0.95 * flats, head.chamfer, -head.depth)
    normal = np.concatenate([[[0.0, 0.0, -1.0]], sides[0], edges[0]])
    distance = np.concatenate([[head.depth], sides[1], edges[1]])
    middle = np.concatenate([[down], sides[2], edges[2]])
    return _single(scene, center, normal, distance, middle, max(head.imprint_radius, head.depth))


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
    center = place_body(
        scene, "a ball", np.full(2, reach), depth, declared_sites(scene)[:, 1].mean()
    )
    steepest = np.arccos(1.0 - depth / radius)
    rings = [
        _cone(
            8 + 4 * i, 0.0, radius * np.sin(slope), slope, radius - depth - radius * np.cos(slope)
        )
        for i, slope in enumerate(np.linspace(0.0, steepest, BALL_RINGS + 1)[1:])
    ]
    end = np.array([[0.0, 0.0, -1.0]]), np.array([depth]), np.array([[0.0, 0.0, -depth]])
    normal, distance, middle = (np.concatenate(part) for part in zip(end, *rings, strict=True))
    return _single(scene, center, normal, distance, middle, max(reach, depth))


def straight_edge(scene: Scene, depth: float = 1.0) -> Imprint:
    """Return a straight edge across the middle of the sites: two planes that meet in a line.

    The line lies ``depth`` mm deep and runs across the pad (along x); the skin drapes over its
    ends.

    Raises:
        SceneError: the pad is too small or too thin for it.
    """
    half = 0.5 * min(EDGE_LENGTH, 0.5 * scene.pad.width)
    reach = np.array([half + depth / np.tan(DRAPE), depth / np.tan(EDGE_SLOPE)])
    center = place_body(scene, "an edge", reach, depth, declared_sites(scene)[:, 1].mean())
    faces = [
        _cone(2, first, radius + 0.5 * depth / np.tan(slope), slope, -0.5 * depth)
        for first, radius, slope in ((0.0, 0.0, EDGE_SLOPE), (np.pi / 2, half, DRAPE))
    ]
    normal, distance, middle = (np.concatenate(part) for part in zip(*faces, strict=True))
    return _single(scene, center, normal, distance, middle, max(*reach, depth))


def imprint_depth(
    imprint: Imprint | HeightMap, x: Array, y: Array, height: Array | float | None = None
) -> Array:
    """Return how deep the skin is pressed in at flat places ``x, y`` (mm), in mm; 0 beside it.

    Straight down from ``height`` (mm) of the skin there; None is that of the bodies' centers.
    """
    if isinstance(imprint, HeightMap):
        return imprint.at(x, y)
    depth = np.zeros(np.broadcast(x, y).shape)
    for center, turn in zip(imprint.center, imprint.turn, strict=True):
        above = 0.0 if height is None else height - center[2]
        offset = np.stack(np.broadcast_arrays(x - center[0], y - center[1]), axis=-1)
        lowest = np.full(depth.shape, np.inf)
        for normal, distance in zip(imprint.normal @ turn.T, imprint.distance, strict=True):
            room = distance - offset @ normal[:2]
            if normal[2] < -UPRIGHT:
                lowest = np.minimum(lowest, room / -normal[2])
            else:
                lowest = np.where(room < normal[2] * above, -np.inf, lowest)
        depth = np.maximum(depth, lowest + above)
    return depth


def smoothed_skin(scene: Scene, imprint: Imprint, smoothing: float) -> HeightMap:
    """Return the skin over a body, see `HeightMap.smoothed`; ``smoothing`` in mm."""
    x, y = map_lines(scene)
    height = skin_heights(scene, x, y)
    depth = imprint_depth(imprint, x[None, :], y[:, None], height)
    return HeightMap(depth, scene.pad.width, scene.pad.length).smoothed(smoothing)


def skin_heights(scene: Scene, x: Array, y: Array) -> Array:
    """Return the height (mm) of the untouched skin on the lines ``x``, ``y``: ``(row, column)``."""
    return SkinChart(scene, 0.0).height(np.stack(np.meshgrid(x, y), axis=-1))


def place_body(scene: Scene, name: str, half: Array, depth: float, y: float) -> Array:
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
    return SkinChart(scene, 0.0).flat(np.clip(wanted, -room, room))


def _single(
    scene: Scene, center: Array, normal: Array, distance: Array, middle: Array, size: float
) -> Imprint:
    return Imprint(
        center=center[None],
        turn=SkinChart(scene, 0.0).frames(center[None, :2]),
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
