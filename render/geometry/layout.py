"""Where sites and facets are: positions and normals at any bend.

Sites are numbered row by row from the base, each row from left (-x) to
right. Facet ``i`` of a site has the normal ``n_i = (theta_n, 2 pi i / faces)`` (thesis eq. 4.2 and
4.6), azimuth 0 towards the tip, and points into the pad, at the camera.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from render.arrays import Array
from render.geometry.chart import SkinChart
from render.scene import Scene


def declared_sites(scene: Scene) -> Array:
    """Return the centers of all sites of the file on the flat pad, ``(site, 3)`` mm.

    Those that count are `render.geometry.seen_sites.flat_sites`.
    """
    return SkinChart(scene, 0.0).flat(scene.sites.places)


def site_frames(scene: Scene, bend: float) -> Array:
    """Return rotations ``(site, 3, 3)`` from the frames of declared sites, see `SkinChart.frames`.

    Where a state turns the skin about its normal, sites turn with it.
    """
    turn = SkinChart(scene, bend).frames(declared_sites(scene)[:, :2])
    return turn if scene.sites.carried is None else turned_about_normal(turn, scene.sites.turns)


def turned_about_normal(frames: Array, angle: Array) -> Array:
    """Return frames ``(..., 3, 3)`` turned about their last axis by ``angle`` ``(...)`` rad."""
    cos, sin, zero = np.cos(angle), np.sin(angle), np.zeros_like(angle)
    rows = [[cos, -sin, zero], [sin, cos, zero], [zero, zero, zero + 1.0]]
    return np.asarray(frames @ np.stack([np.stack(row, axis=-1) for row in rows], axis=-2))


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
    """Facets of all declared sites in the world frame at one bend.

    corners ``(site, facet, corner, 3)`` mm, centroid and normal ``(site, facet, 3)``;
    ``site_position`` and ``site_normal`` ``(site, 3)`` are those of the untouched pad.
    """

    corners: Array
    centroid: Array
    normal: Array
    site_position: Array
    site_normal: Array


def facets(scene: Scene, bend: float) -> Facets:
    """Return the facets at ``bend`` radians; each pyramid is rigid in its site's frame.

    Of a scene with ``states``, ``bend`` is the number of one.
    """
    if scene.states is not None:
        return facets(scene.in_state(bend), 0.0)
    position, turn = (
        SkinChart(scene, bend).points(declared_sites(scene)[:, :2]),
        site_frames(scene, bend),
    )
    corners = position[:, None, None] + np.einsum("sij,fcj->sfci", turn, pyramid(scene))
    normal = np.einsum("sij,fj->sfi", turn, facet_normals(scene))
    return Facets(corners, corners.mean(axis=2), normal, position, -turn[..., 2])
