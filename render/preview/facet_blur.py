"""Facet blur: how the camera mixes facets, by refraction and the rough lower face, per bend.

Facets are slivers of a few tenths of a millimeter and the rough face blurs by a tenth, so what
the camera sees of one facet is a mixture of its neighbors and of the coating around them. A thick
pad blurs farther than the pyramid reaches: of the coating the feet of facets are told from what the
pyramid neither shades nor lights.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

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
    site_frames,
)
from render.scene import Scene, Window

SUBPIXELS = 2
"""Lines of sight per pixel, in each direction."""
MICROFACETS = 64
"""Microfacet normals per line of sight, in mirrored pairs."""
SIGHTS = 256
"""Lines of sight that are kept of each part of a site."""
RINGS = (1.0, 1.3, 2.0, 3.2, 5.0)
"""Bounds of the coating that is before a facet, in radii of the pyramid; the first ring, the foot,
is told from the untouched spot on every pad, the others where the lower face blurs so far."""
FAR_BLUR = 1.7
"""Roughness times thickness over the radius of the pyramid from which on all rings are told apart:
coating is then more than a third of what is seen of a facet (RESULTS.md of the validation)."""
BEYOND = 2.0
"""Radii from which on the coating is lit as the untouched spot; in part as that from the feet on.
Of 1.6 to 3.5, light of random-20 was best by 2.0 to 2.5, and that of random-4 and 6 by any."""
MAX_TARGET_PIXELS = 256
"""Pixels per target that are followed: a target with more is seen by an even choice of them."""


def ring_count(scene: Scene) -> int:
    """Return how many rings of coating around the pyramid the camera mixes with facets."""
    window = 0.0 if scene.window is None else scene.window.thickness
    blur = scene.finish("lower").roughness * (scene.pad.thickness + window)
    return len(RINGS) - 1 if blur > FAR_BLUR * scene.indenter.radius else 1


def facet_blur(scene: Scene, bend: float) -> Array:
    """Return `facet_blurs` of a coating of one albedo with one ring."""
    (blur,) = facet_blurs(scene, bend, 1)
    return blur


@lru_cache(maxsize=64)
def facet_blurs(scene: Scene, bend: float, rings: int) -> tuple[Array, ...]:
    """Return camera radiance per irradiance on the coating.

    ``(site, facet + 1, facet + rings * facet + 1)``, one for each of the scene's `albedos`.

    Row: the mask of pixels that is looked at (facets, then the untouched site); column: what sends
    the light (facets, the coating before each, ring by ring, then the untouched site). A single
    ring is the foot alone, and from there on the untouched site has more and more. The radiance is
    albedo / pi times the irradiance, times the transmittance of the lower face, and of the bond of
    a window, over the pad's index squared (Veach 1997, eq. 5.3). Sites are those that count. At a
    bend that the scene does not name, a facet may be without a pixel: it gets the row of a head-on,
    sharp view. A coating with a lobe is one of its whole reflectance here.
    """
    counted, faces = counted_sites(scene), scene.indenter.faces
    weights = np.zeros((len(counted), faces + 1, (1 + rings) * faces + 1))
    for index, target, lines in _targets(scene, bend, rings):
        if lines is None:
            weights[index, target, target if target < faces else -1] = _head_on(scene)
            continue
        near = lines.weight * lines.near
        seen = np.bincount(lines.seen.ravel(), near.ravel(), minlength=(1 + rings) * faces)
        weights[index, target] = [*seen, np.sum(lines.weight - near)]
        weights[index, target] /= lines.weight.size
    blurs = tuple(
        weights * one.coating.reflectance / (np.pi * scene.pad.index**2)
        for one in scene.one_albedo_scenes
    )
    for blur in blurs:
        # Every preview of the scene has these.
        blur.flags.writeable = False
    return blurs


def lines_of_sight(scene: Scene, bend: float, count: int = SIGHTS) -> Array:
    """Return directions in the pad in which the camera sees parts of sites, for skins with a lobe.

    ``(site, facet + 2, count, 3)``, unit vectors in the world onto the facets, onto the coating
    before them, and onto the untouched spot; lines of one part are as likely as each other. Sites
    are those that count. What no line meets is seen as the spot is, and that head-on.
    """
    counted, faces = counted_sites(scene), scene.indenter.faces
    sights = np.zeros((len(counted), faces + 2, count, 3))
    for index, target, lines in _targets(scene, bend, 1):
        if lines is None:
            continue
        parts = [target] if target < faces else []
        # Before facets the coating is met by lines of all targets: the last facet's will do.
        parts += [faces] if target < faces else [faces + 1]
        for part in parts:
            wanted = lines.seen == part if part < faces else lines.seen >= faces
            weight = lines.weight[wanted]
            if weight.sum() > 0.0:
                steps = (np.arange(count) + 0.5) / count * weight.sum()
                chosen = np.minimum(np.searchsorted(np.cumsum(weight), steps), len(weight) - 1)
                sights[index, part] = lines.direction[wanted][chosen]
    known = np.asarray(sights.any(axis=(-1, -2)))[..., None, None]
    head_on = SkinChart(scene, bend).frames(declared_sites(scene)[counted, :2])[:, None, None, :, 2]
    spot = np.where(known[:, -1:], sights[:, -1:], head_on)
    return np.where(known, sights, spot)


class _Lines(NamedTuple):
    """Lines of sight of one target: ``seen`` ``(pixel, line, normal)`` the facet each meets.

    The coating has the numbers from that of the facets on, one for each that it is before, ring by
    ring; where it is lit in part or all as the untouched site, ``near`` is less than 1.
    ``direction`` is one more axis of 3, in the world.
    """

    seen: NDArray[np.int64]
    near: Array
    weight: Array
    direction: Array


def _targets(scene: Scene, bend: float, rings: int) -> Iterator[tuple[int, int, _Lines | None]]:
    """Yield site (of those that count), target and its lines of sight, None without a pixel."""
    masks = _thinned(facet_masks(scene, bend))
    position = facets(scene, bend).site_position
    owner = np.repeat(np.arange(len(masks.offset) - 1), np.diff(masks.offset))
    entry, outside = _lines_of_sight(scene, bend, masks)
    directions, weight = _refracted(scene, bend, entry, outside)
    entry = entry[..., None, :]
    if scene.window is not None:
        entry, directions, weight = _past_bond(scene, scene.window, entry, directions, weight)
    faces = masks.facets
    frames = site_frames(scene, bend)
    for index, site in enumerate(counted_sites(scene)):
        turn = frames[site]
        for target in range(faces + 1):
            chosen = owner == site * (faces + 1) + target
            if not chosen.any():
                yield index, target, None
                continue
            start = (entry[chosen] - position[site]) @ turn
            seen, near = _first_met(scene, start, directions[chosen] @ turn, rings)
            if target == faces:  # There is no pyramid.
                seen, near = np.full_like(seen, faces), np.zeros_like(near)
            yield index, target, _Lines(seen, near, weight[chosen], directions[chosen])


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
    indices = window.index, pad / window.index
    return float(np.prod([1 - fresnel(np.ones(1), eta)[0] for eta in indices]))


def _slopes() -> Array:
    """Return `MICROFACETS` slopes ``(normal, 2)`` of a surface with alpha 1, evenly spread."""
    pairs = MICROFACETS // 2
    index = np.arange(pairs) + 0.5
    radius = np.sqrt(-np.log1p(-index / pairs))
    golden = np.pi * (3 - np.sqrt(5)) * index
    half = np.stack([radius * np.cos(golden), radius * np.sin(golden)], axis=-1)
    return np.concatenate([half, half * [-1, 1]])


def _first_met(
    scene: Scene, start: Array, direction: Array, rings: int
) -> tuple[NDArray[np.int64], Array]:
    """Return what lines meet and how near it is, as in `_Lines`.

    Local frame of the site: ``direction`` ``(pixel, line, normal, 3)``, and so ``start``, or with
    one normal. The pyramid is convex: the last plane entered is met, unless another plane or
    the coating is left before.
    """
    corners, faces = pyramid(scene), scene.indenter.faces
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
    x, y = np.moveaxis((start + coating[..., None] * direction)[..., :2], -1, 0)
    before = np.rint(np.arctan2(x, y) * (faces / (2 * np.pi))).astype(np.int64) % faces
    radii = np.hypot(x, y) / scene.indenter.radius
    if rings == 1:
        near = np.clip((BEYOND - radii) / (BEYOND - RINGS[1]), 0.0, 1.0)
    else:
        near = np.where(radii < RINGS[rings], 1.0, 0.0)
    ring = np.searchsorted(RINGS[1:rings], radii, side="right")
    return np.where(meets, facet, faces * (1 + ring) + before), np.where(meets, 1.0, near)
