"""Convex bodies pressed into the pad: the pyramids of the metric, and a bolt for the eyes.

A body is the intersection of half-spaces that the coating's plane cuts; its frame is that of the
untouched pad at its center: across, towards the tip, towards the coating. It follows the bend.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from render.arrays import Array
from render.errors import SceneError
from render.geometry.layout import facet_normals, flat_sites, pyramid
from render.scene import Scene

SHADOW_LENGTH = 4.0
"""How far from its center a body's shadow is drawn, in units of its radius or its depth."""


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
        center=flat_sites(scene),
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
    drape: float = np.pi / 3
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
    pad, sites = scene.pad, flat_sites(scene)
    room_x, room_y = pad.width / 2 - head.imprint_radius, pad.length / 2 - head.imprint_radius
    if min(room_x, room_y) < 0 or head.depth >= pad.thickness:
        raise SceneError(
            f"a bolt of {2 * head.imprint_radius:.3g} mm pressed {head.depth:g} mm deep does not "
            f"fit into the pad of {pad.width:g} x {pad.length:g} x {pad.thickness:g} mm",
            field="pad",
        )
    x = np.clip(sites[:, 0].mean(), -room_x, room_x)
    y = np.clip(sites[:, 1].min(), -room_y, room_y)
    flats, down = head.radius * np.cos(np.pi / 6), np.array([0.0, 0.0, -head.depth])
    half = 0.5 * head.depth
    sides = _cone(6, np.pi / 6, flats + half / np.tan(head.drape), head.drape, -half)
    # The cone meets the end a little inside the flats, as turned bolts do.
    edges = _cone(12, 0.0, 0.95 * flats, head.chamfer, -head.depth)
    normal = np.concatenate([[[0.0, 0.0, -1.0]], sides[0], edges[0]])
    distance = np.concatenate([[head.depth], sides[1], edges[1]])
    middle = np.concatenate([[down], sides[2], edges[2]])
    return Imprint(
        center=np.array([[x, y, pad.thickness]]),
        columns=1,
        rows=1,
        spacing=1.0,
        normal=normal,
        distance=distance,
        middle=middle,
        size=max(head.imprint_radius, head.depth),
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
