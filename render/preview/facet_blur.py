"""Facet blur: how the camera mixes facets, by refraction and the rough lower face, per bend.

Facets are slivers of a few tenths of a millimeter and the rough face blurs by a tenth, so what
the camera sees of one facet is a mixture of its neighbors and of the coating around them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from render.arrays import Array
from render.geometry import (
    FacetMasks,
    SkinChart,
    camera_origin,
    counted_sites,
    curvature,
    declared_sites,
    facet_masks,
    facets,
    fresnel,
    pixel_directions,
    pyramid,
    refract_into_pad,
)
from render.scene import Scene, Window

SUBPIXELS = 2
"""Lines of sight per pixel, in each direction."""
MICROFACETS = 64
"""Microfacet normals per line of sight, in mirrored pairs."""
MAX_TARGET_PIXELS = 256
"""Pixels per target that are followed: a target with more is seen by an even choice of them."""


def facet_blur(scene: Scene, bend: float) -> Array:
    """Return camera radiance per irradiance on the coating, ``(site, facet + 1, facet + 1)``.

    Row: the mask of pixels that is looked at (facets, then the untouched site); column: what sends
    the light. The radiance is albedo / pi times the irradiance, times the transmittance of the
    lower face, and of the bond of a window, over the pad's index squared (Veach 1997, eq. 5.3).
    Sites are those that count. At a bend
    that the scene does not name, a facet may be without a pixel: it gets the row of a head-on,
    sharp view.
    """
    masks = _thinned(facet_masks(scene, bend))
    position = facets(scene, bend).site_position
    owner = np.repeat(np.arange(len(masks.offset) - 1), np.diff(masks.offset))
    entry, outside = _lines_of_sight(scene, bend, masks)
    directions, weight = _refracted(scene, bend, entry, outside)
    entry = entry[..., None, :]
    if scene.window is not None:
        entry, directions, weight = _past_bond(scene, scene.window, entry, directions, weight)
    counted, faces = counted_sites(scene), masks.facets
    weights = np.zeros((len(counted), faces + 1, faces + 1))
    for index, site in enumerate(counted):
        turn = SkinChart(scene, bend).frames(declared_sites(scene)[site, :2])
        for target in range(faces + 1):
            chosen = owner == site * (faces + 1) + target
            if not chosen.any():
                weights[index, target, target] = _head_on(scene)
                continue
            start = (entry[chosen] - position[site]) @ turn
            seen = _first_facet(scene, start, directions[chosen] @ turn)
            seen = np.where(target == faces, faces, seen)
            lines = weight[chosen]
            weights[index, target] = (
                np.bincount(seen.ravel(), lines.ravel(), minlength=faces + 1) / lines.size
            )
    return weights * scene.coating.albedo / (np.pi * scene.pad.index**2)


def _thinned(masks: FacetMasks) -> FacetMasks:
    """Return the masks with at most `MAX_TARGET_PIXELS` pixels per target."""
    size = np.diff(masks.offset)
    if size.max(initial=0) <= MAX_TARGET_PIXELS:
        return masks
    thinned = np.minimum(size, MAX_TARGET_PIXELS)
    chosen = [
        first + np.arange(number) * max(count, 1) // max(number, 1)
        for first, count, number in zip(masks.offset[:-1], size, thinned, strict=True)
    ]
    offset = np.concatenate([[0], np.cumsum(thinned)])
    return replace(masks, pixel=masks.pixel[np.concatenate(chosen)], offset=offset)


def _lines_of_sight(scene: Scene, bend: float, masks: FacetMasks) -> tuple[Array, Array]:
    """Return where lines through the masks' pixels enter the pad, and their directions in air.

    Both ``(pixel, line, 3)``; the pixels in the order of ``masks.pixel``. With a window they enter
    that, at its lower face.
    """
    steps = (np.arange(SUBPIXELS) + 0.5) / SUBPIXELS
    step_y, step_x = (step.ravel() for step in np.meshgrid(steps, steps, indexing="ij"))
    column = (masks.pixel % masks.columns)[:, None] + step_x
    row = (masks.pixel // masks.columns)[:, None] + step_y
    outside = pixel_directions(scene, masks.columns, masks.rows, column, row)
    if scene.window is not None:
        origin = camera_origin(scene)
        way = (-scene.window.thickness - origin[2]) / outside[..., 2:]
        return origin + way * outside, outside
    return refract_into_pad(scene, bend, camera_origin(scene), outside).entry, outside


def _refracted(scene: Scene, bend: float, entry: Array, outside: Array) -> tuple[Array, Array]:
    """Return directions behind the face ``(..., normal, 3)``, transmittances over microfacets.

    Slopes of a Beckmann surface are Gaussian with variance alpha^2 / 2; each microfacet counts by
    the area that it turns to the camera (Walter et al. 2007).
    """
    kappa = curvature(scene, bend)
    kappa_face = kappa / (1 + kappa * scene.pad.thickness)
    index = scene.pad.index if scene.window is None else scene.window.index
    y = entry[..., 1] - scene.camera.pivot
    normal = np.stack([np.zeros_like(y), kappa_face * y, kappa_face * entry[..., 2] - 1], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    across = np.broadcast_to([1.0, 0.0, 0.0], normal.shape)
    slope = scene.finish("lower").roughness * _slopes()
    micro = normal[..., None, :] + (
        slope[:, :1] * across[..., None, :] + slope[:, 1:] * np.cross(normal, across)[..., None, :]
    )
    facing = -np.einsum("...i,...ni->...n", outside, micro)
    micro /= np.linalg.norm(micro, axis=-1, keepdims=True)
    cos_in = np.maximum(-np.einsum("...i,...ni->...n", outside, micro), 1e-6)
    reflected, cos_out = fresnel(cos_in, index)
    ratio = 1 / index
    direction = ratio * outside[..., None, :] + (ratio * cos_in - cos_out)[..., None] * micro
    straight = -np.einsum("...i,...i->...", outside, normal)[..., None]
    area = np.maximum(facing, 0.0) / np.maximum(straight, 1e-6)
    return direction, (1 - reflected) * area


def _past_bond(
    scene: Scene, window: Window, entry: Array, direction: Array, weight: Array
) -> tuple[Array, Array, Array]:
    """Return where lines in the window enter the pad, their directions there and what passes.

    ``entry`` ``(..., 1, 3)`` is on the window's lower face, ``direction`` ``(..., normal, 3)``.
    """
    rise = np.maximum(direction[..., 2:], 1e-6)
    entry = entry + direction * (window.thickness / rise)
    entry[..., 2] = 0.0
    eta = scene.pad.index / window.index
    reflected, cos_out = fresnel(rise[..., 0], eta)
    direction = np.concatenate([direction[..., :2] / eta, cos_out[..., None]], axis=-1)
    return entry, direction, weight * (1 - reflected)


def _head_on(scene: Scene) -> float:
    """Return what passes all faces head on."""
    pad, window = scene.pad.index, scene.window
    if window is None:
        return float(1 - fresnel(np.ones(1), pad)[0][0])
    plate = window.index
    return float(np.prod([1 - fresnel(np.ones(1), eta)[0] for eta in (plate, pad / plate)]))


def _slopes() -> Array:
    """Return `MICROFACETS` slopes ``(normal, 2)`` of a surface with alpha 1, evenly spread."""
    pairs = MICROFACETS // 2
    index = np.arange(pairs) + 0.5
    radius = np.sqrt(-np.log1p(-index / pairs))
    golden = np.pi * (3 - np.sqrt(5)) * index
    half = np.stack([radius * np.cos(golden), radius * np.sin(golden)], axis=-1)
    return np.concatenate([half, half * [-1, 1]])


def _first_facet(scene: Scene, start: Array, direction: Array) -> np.ndarray:
    """Return the facet that lines meet, the number of facets where they pass the pyramid.

    Local frame of the site: ``direction`` ``(pixel, line, normal, 3)``, and so ``start``, or with
    one normal. The pyramid is convex: the last plane entered is met, unless another plane or
    the coating is left before.
    """
    corners = pyramid(scene)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    # Outward is towards the camera, -z.
    normal *= -np.sign(normal[:, 2:]) / np.linalg.norm(normal, axis=-1, keepdims=True)
    speed = direction @ normal.T
    distance = np.einsum("ki,ki->k", normal, corners[:, 0]) - start @ normal.T
    with np.errstate(divide="ignore"):
        plane_distance = distance / speed
    entered = np.where(speed < 0, plane_distance, -np.inf)
    facet = entered.argmax(axis=-1)
    exit_distance = np.where(speed >= 0, plane_distance, np.inf).min(axis=-1)
    coating = -start[..., 2] / direction[..., 2]
    meets = entered.max(axis=-1) < np.minimum(exit_distance, coating)
    return np.where(meets, facet, len(corners))
