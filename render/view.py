"""How the camera mixes the facets: refraction and blur by the rough lower face, per bend.

Facets are slivers of a few tenths of a millimetre and the rough face blurs by a tenth, so what
the camera sees of one facet is a mixture of its neighbours and of the coating around them.
"""

from __future__ import annotations

import numpy as np

from render.bending import Array, bend_frames, curvature
from render.camera import camera_origin
from render.layout import Facets, facets, flat_sites, pyramid
from render.refraction import refract_into_pad
from render.rough_face import fresnel
from render.scene import Scene

SHRINK = 0.85
"""Facets are seen within themselves, shrunk by this factor about their centroid."""
NORMALS = 48
"""Microfacet normals per line of sight."""
AIMS = 30
"""Corrections of a line of sight, each several times better than the last."""


def view_weights(scene: Scene, bend: float) -> Array:
    """Return radiance at the camera per irradiance on the coating, ``(site, facet + 1, facet + 1)``.

    Row: what is looked at (facets, then the untouched site); column: what sends the light. The
    radiance is albedo / pi times the irradiance, times the transmittance of the lower face over
    the index squared (Veach 1997, eq. 5.3). A facet that the camera cannot see gets the row of an
    unhindered view: mask it (`render.camera.facet_masks`).
    """
    placed = facets(scene, bend)
    aim = _aims(placed)
    entry, outside = _lines_of_sight(scene, bend, aim)
    directions, weight = _refracted(scene, bend, entry, outside)
    sites, faces = placed.normal.shape[:2]
    weights = np.zeros((sites, faces + 1, faces + 1))
    for site in range(sites):
        turn = bend_frames(scene, flat_sites(scene)[site, 1], bend)
        start = (entry[site] - placed.site_position[site]) @ turn
        seen = _first_facet(scene, start, directions[site] @ turn)
        for facet in range(faces):
            weights[site, facet] = np.bincount(
                seen[facet].ravel(), weight[site, facet].ravel(), minlength=faces + 1
            )
        weights[site, faces, faces] = weight[site, faces].sum()
    weights /= aim.shape[2] * NORMALS
    unseen = weights.sum(axis=-1) == 0
    weights[unseen] = np.eye(faces + 1)[np.nonzero(unseen)[1]]
    return weights * scene.coating.albedo / (np.pi * scene.pad.index**2)


def _aims(placed: Facets) -> Array:
    """Return points on facets and sites that are looked at, ``(site, facet + 1, point, 3)`` mm."""
    # Dunavant's rule of degree 4 has its six points well inside the triangle.
    a, b = 0.445948490915965, 0.091576213509771
    share = np.array(
        [np.roll([1 - 2 * v, v, v], shift) for v in (a, b) for shift in range(3)]
    )
    share = SHRINK * share + (1 - SHRINK) / 3
    on_facets = np.einsum("pc,sfci->sfpi", share, placed.corners)
    at_site = np.broadcast_to(
        placed.site_position[:, None, None], (len(on_facets), 1, len(share), 3)
    )
    return np.concatenate([on_facets, at_site], axis=1)


def _lines_of_sight(scene: Scene, bend: float, target: Array) -> tuple[Array, Array]:
    """Return where lines from the camera enter the pad, and their directions in air, ``(..., 3)``.

    Fixed-point iteration: aim, trace, shift the aim by what the refracted line misses.
    """
    origin = camera_origin(scene)
    aim = target.copy()
    for _ in range(AIMS):
        outside = aim - origin
        outside /= np.linalg.norm(outside, axis=-1, keepdims=True)
        rays = refract_into_pad(scene, bend, origin, outside)
        to_target = target - rays.entry
        along = np.sum(to_target * rays.direction, axis=-1, keepdims=True)
        miss = to_target - along * rays.direction
        aim = aim + np.where(rays.inside[..., None], miss, 0.0)
    return rays.entry, outside


def _refracted(scene: Scene, bend: float, entry: Array, outside: Array) -> tuple[Array, Array]:
    """Return directions in the pad ``(..., normal, 3)`` and transmittances over microfacets.

    Slopes of a Beckmann surface are Gaussian with variance alpha^2 / 2; each microfacet counts by
    the area that it turns to the camera (Walter et al. 2007).
    """
    kappa = curvature(scene, bend)
    kappa_face = kappa / (1 + kappa * scene.pad.thickness)
    y = entry[..., 1] - scene.camera.y
    normal = np.stack(
        [np.zeros_like(y), kappa_face * y, kappa_face * entry[..., 2] - 1], axis=-1
    )
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    across = np.broadcast_to([1.0, 0.0, 0.0], normal.shape)
    slope = scene.pad.roughness * _slopes()
    micro = normal[..., None, :] + (
        slope[:, :1] * across[..., None, :] + slope[:, 1:] * np.cross(normal, across)[..., None, :]
    )
    facing = -np.einsum("...i,...ni->...n", outside, micro)
    micro /= np.linalg.norm(micro, axis=-1, keepdims=True)
    cos_in = np.maximum(-np.einsum("...i,...ni->...n", outside, micro), 1e-6)
    reflected, cos_out = fresnel(cos_in, scene.pad.index)
    ratio = 1 / scene.pad.index
    direction = (
        ratio * outside[..., None, :] + (ratio * cos_in - cos_out)[..., None] * micro
    )
    straight = -np.einsum("...i,...i->...", outside, normal)[..., None]
    area = np.maximum(facing, 0.0) / np.maximum(straight, 1e-6)
    return direction, (1 - reflected) * area


def _slopes() -> Array:
    """Return `NORMALS` slopes ``(normal, 2)`` of a surface with alpha 1, evenly spread."""
    index = np.arange(NORMALS) + 0.5
    radius = np.sqrt(-np.log1p(-index / NORMALS))
    golden = np.pi * (3 - np.sqrt(5)) * index
    return np.stack([radius * np.cos(golden), radius * np.sin(golden)], axis=-1)


def _first_facet(scene: Scene, start: Array, direction: Array) -> np.ndarray:
    """Return the facet that lines meet, the number of facets where they pass the pyramid.

    Local frame of the site: ``start`` ``(facet, point, 3)``, ``direction`` ``(facet, point,
    normal, 3)``. The pyramid is convex: the last plane entered is met, unless another plane or
    the coating is left before.
    """
    corners = pyramid(scene)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    # Outward is towards the camera, -z.
    normal *= -np.sign(normal[:, 2:]) / np.linalg.norm(normal, axis=-1, keepdims=True)
    speed = direction @ normal.T
    distance = np.einsum("ki,ki->k", normal, corners[:, 0]) - start @ normal.T
    with np.errstate(divide="ignore"):
        way = distance[:, :, None] / speed
    entered = np.where(speed < 0, way, -np.inf)
    facet = entered.argmax(axis=-1)
    left = np.where(speed >= 0, way, np.inf).min(axis=-1)
    coating = -start[..., 2][..., None] / direction[..., 2]
    meets = entered.max(axis=-1) < np.minimum(left, coating)
    return np.where(meets, facet, len(corners))
