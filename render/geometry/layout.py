"""Where fibers, sites and facets are: positions, directions and normals at any bend.

Fibers are numbered around the pad: left edge from base to tip, tip edge from left to right, right
edge from tip to base. Sites are numbered row by row from the base, each row from left (-x) to
right. Facet ``i`` of a site has the normal ``n_i = (theta_n, 2 pi i / faces)`` (thesis eq. 4.2 and
4.6), azimuth 0 towards the tip, and points into the pad, at the camera.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from render.arrays import Array
from render.errors import SceneError
from render.geometry.bending import bend_frames, bend_points
from render.scene import EDGES, Edge, Scene


@dataclass(frozen=True)
class FiberPoses:
    """Fiber ends in the world frame (mm, unit vectors); every array is ``(fiber, 3)`` float64.

    ``along`` is phi = 0 (towards the tip on the sides, towards +x at the tip), ``inward`` is
    phi = pi/2 (normal to the edge), ``up`` points to the coating.
    """

    position: Array
    along: Array
    inward: Array
    up: Array

    def directions(self, phi: Array, tilt: float) -> Array:
        """Return unit beam directions ``(..., fiber, 3)`` for ``phi`` ``(..., fiber)`` radians."""
        cos, sin = np.cos(phi)[..., None], np.sin(phi)[..., None]
        in_plane = cos * self.along + sin * self.inward
        return np.asarray(np.cos(tilt) * in_plane + np.sin(tilt) * self.up)


def fiber_edges(scene: Scene) -> list[Edge]:
    """Return the edge that each fiber stands on."""
    return [edge for edge in EDGES for _ in range(getattr(scene.fibers, edge))]


def mirrored_fibers(scene: Scene) -> np.ndarray:
    """Return, per fiber, the index of its mirror image in the plane x = 0.

    Raises:
        SceneError: when the left and right edges hold different numbers of fibers.
    """
    fibers = scene.fibers
    if fibers.left != fibers.right:
        raise SceneError(
            f"fibers.left = {fibers.left} and fibers.right = {fibers.right} have no mirror "
            "images, allowed: the same number",
            field="fibers.left",
            value=fibers.left,
        )
    return np.arange(scene.fibers.count)[::-1]


def flat_fiber_poses(scene: Scene) -> FiberPoses:
    """Return the fiber ends on the flat pad."""
    margin = scene.diffuser.thickness if scene.diffuser else 0.0
    half_width, half_length = scene.pad.width / 2, scene.pad.length / 2
    offset = margin + scene.fibers.gap
    position, along, inward = [], [], []
    for edge in EDGES:
        n = getattr(scene.fibers, edge)
        t = (np.arange(n) + 0.5) / n if n else np.zeros(0)
        if edge == "tip":
            x, y = (2 * t - 1) * half_width, np.full(n, half_length + offset)
            along += [(1.0, 0.0, 0.0)] * n
            inward += [(0.0, -1.0, 0.0)] * n
        else:
            sign = -1.0 if edge == "left" else 1.0
            x = np.full(n, sign * (half_width + offset))
            y = -sign * (2 * t - 1) * half_length
            along += [(0.0, 1.0, 0.0)] * n
            inward += [(-sign, 0.0, 0.0)] * n
        position += [(*xy, scene.fibers.height) for xy in zip(x, y, strict=True)]
    up = np.tile([0.0, 0.0, 1.0], (scene.fibers.count, 1))
    return FiberPoses(np.array(position), np.array(along), np.array(inward), up)


def fiber_poses(scene: Scene, bend: float) -> FiberPoses:
    """Return the fiber ends in the world at ``bend`` radians; they are carried by the body."""
    flat = flat_fiber_poses(scene)
    turn = bend_frames(scene, flat.position[:, 1], bend)
    along, inward, up = (
        np.einsum("fij,fj->fi", turn, v) for v in (flat.along, flat.inward, flat.up)
    )
    return FiberPoses(bend_points(scene, flat.position, bend), along, inward, up)


def flat_sites(scene: Scene) -> Array:
    """Return the site centers on the flat coating, ``(site, 3)`` mm."""
    sites = scene.sites
    x = sites.centre_x + (np.arange(sites.columns) - (sites.columns - 1) / 2) * sites.spacing
    y = sites.centre_y + (np.arange(sites.rows) - (sites.rows - 1) / 2) * sites.spacing
    grid_y, grid_x = np.meshgrid(y, x, indexing="ij")
    z = np.full(grid_x.size, scene.pad.thickness)
    return np.stack([grid_x.ravel(), grid_y.ravel(), z], axis=-1)


def facet_normals(scene: Scene) -> Array:
    """Return the facet normals in the flat site frame, ``(facet, 3)``, eq. (4.2) with -z up."""
    azimuth = 2 * np.pi * np.arange(scene.indenter.faces) / scene.indenter.faces
    sin, cos = np.sin(scene.indenter.slope), np.cos(scene.indenter.slope)
    return np.stack(
        [sin * np.sin(azimuth), sin * np.cos(azimuth), np.full_like(azimuth, -cos)], axis=-1
    )


def pyramid(scene: Scene) -> Array:
    """Return the facets of one pyramid relative to its site, ``(facet, corner, 3)`` mm.

    Corners: apex, then the two base corners. The base polygon has circumradius
    ``indenter.radius``; the apex is pressed towards the camera so that facets slope by
    ``indenter.slope``.
    """
    faces = scene.indenter.faces
    azimuth = 2 * np.pi * (np.arange(faces + 1) - 0.5) / faces
    ring = scene.indenter.radius * np.stack([np.sin(azimuth), np.cos(azimuth)], axis=-1)
    ring = np.concatenate([ring, np.zeros((faces + 1, 1))], axis=-1)
    apex = np.array([0.0, 0.0, -scene.indenter.depth])
    return np.stack([np.tile(apex, (faces, 1)), ring[:-1], ring[1:]], axis=1)


@dataclass(frozen=True)
class Facets:
    """Facets of all sites in the world frame at one bend.

    corners ``(site, facet, corner, 3)`` mm, centroid and normal ``(site, facet, 3)``;
    ``site_position`` and ``site_normal`` ``(site, 3)`` are those of the untouched pad.
    """

    corners: Array
    centroid: Array
    normal: Array
    site_position: Array
    site_normal: Array


def facets(scene: Scene, bend: float) -> Facets:
    """Return the facets at ``bend`` radians; each pyramid is rigid in its site's frame."""
    flat = flat_sites(scene)
    position = bend_points(scene, flat, bend)
    turn = bend_frames(scene, flat[:, 1], bend)
    corners = position[:, None, None] + np.einsum("sij,fcj->sfci", turn, pyramid(scene))
    normal = np.einsum("sij,fj->sfi", turn, facet_normals(scene))
    return Facets(corners, corners.mean(axis=2), normal, position, -turn[..., 2])
