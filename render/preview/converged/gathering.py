"""Gathering: what the camera's targets and the coating get from the light that leaves the layer.

Lines of sight through a target's pixels are refracted by the rough lower face and end on the
coating; from there light is followed backwards until it meets the coating again, collecting what
leaves the layer wherever it enters it, and walking on in the layer. What the coating sends out is
the solution of the same equation on patches: ``X = D + F X``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from render.arrays import Array
from render.geometry import SkinChart, declared_sites, facets
from render.geometry.visibility import BACKGROUND_RADIUS
from render.preview.converged.block import (
    cell_count,
    directions_to_block,
    on_pad,
    orthonormal_terms,
    patch_counts,
    skin_stretch,
    term_count,
    to_block,
)
from render.preview.converged.color_noise import Halved
from render.preview.converged.walks import Block, FaceGrid, find_coating, gather
from render.preview.facet_blur import RINGS
from render.scene import Scene
from render.spread_points import spread_points

FACET_KEY, SITE_KEY, PATCH_KEY = 2 << 40, 3 << 40, 4 << 40
"""Families of the streams of facets, untouched spots and patches."""
RING_BITS = 18
"""Bits of the number of a site's part, below that of a ring of coating."""

NO_GRID = FaceGrid(np.zeros(4, np.int64), np.zeros(4, np.int64), np.zeros(4), 0, 0.0, 0)
"""The grid of a pad whose exit field nobody needs."""
NO_SIGHTS = np.zeros((0, 3))
"""The lines of sight of a coating without a lobe, which looks alike from everywhere."""


class Starts(NamedTuple):
    """Points of the coating from which light is followed backwards.

    Points and normals into the pad ``(path, 3)`` in the frame of the block; lines of sight onto
    them ``(path, 3)``, or none; weights ``(path,)`` of sum 1; ``drawn`` ``(path, 5)``, evenly
    spread numbers for direction and first reflection; the key of the streams of random numbers.
    """

    points: Array
    normals: Array
    sights: Array
    weights: Array
    drawn: Array
    key: int


class Gathered(NamedTuple):
    """What starts get: from the terms of the exit field ``(cell * term,)``, and from patches.

    ``patches`` ``(patch,)`` is the part of the paths that end on each. Both are means over cosine
    distributed directions: times pi they are irradiance per radiance. Of a coating with a lobe they
    are the irradiance that would look as bright on a Lambertian one of its reflectance.
    """

    terms: Array
    patches: Array


def facet_points(
    scene: Scene,
    bend: float,
    site: int,
    facet: int,
    count: int,
    sights: Array = NO_SIGHTS,
    seed: int = 0,
) -> Starts:
    """Return points spread over a facet of a site, seen along ``sights`` ``(sight, 3)`` in turn."""
    key = FACET_KEY + (seed << 20) + int(site) * scene.indenter.faces + facet
    drawn = spread_points(range(count), 7, key)
    shape = facets(scene, bend)
    place = drawn[:, 5:]
    place = np.where(place.sum(axis=1, keepdims=True) > 1.0, 1.0 - place, place)
    corner = to_block(scene, shape.corners[site, facet])
    points = corner[0] + place @ (corner[1:] - corner[0])
    normals = np.tile(directions_to_block(shape.normal[site, facet]), (count, 1))
    weights, drawn = np.full(count, 1 / count), np.ascontiguousarray(drawn[:, :5])
    return Starts(points, normals, _in_turn(sights, count), weights, drawn, key)


def site_points(
    scene: Scene,
    bend: float,
    site: int,
    facet: int | None,
    count: int,
    sights: Array = NO_SIGHTS,
    seed: int = 0,
    ring: int = 0,
) -> Starts:
    """Return points spread over the background spot of a site, or a ring of coating before a facet.

    They are seen along ``sights`` ``(sight, 3)`` in turn; ``ring`` is the number of one of `RINGS`.
    """
    faces = scene.indenter.faces
    key = SITE_KEY + (seed << 20) + int(site) * (faces + 1) + (faces if facet is None else facet)
    key += ring << RING_BITS
    drawn = spread_points(range(count), 7, key)
    if facet is None:
        azimuth = 2 * np.pi * drawn[:, 5]
        radius = BACKGROUND_RADIUS * scene.indenter.radius * np.sqrt(drawn[:, 6])
    else:
        azimuth = 2 * np.pi * (facet + drawn[:, 5] - 0.5) / scene.indenter.faces
        azimuth -= scene.sites.turns[site]
        inner, outer = RINGS[ring : ring + 2]
        radius = scene.indenter.radius * (inner + (outer - inner) * drawn[:, 6])
    offset = np.stack([np.sin(azimuth), np.cos(azimuth)], axis=-1)
    uv = on_pad(scene, declared_sites(scene)[site, :2] + radius[:, None] * offset)
    chart = SkinChart(scene, bend)
    points = to_block(scene, chart.points(uv))
    normals = directions_to_block(-chart.frames(uv)[..., 2])
    weights, drawn = np.full(count, 1 / count), np.ascontiguousarray(drawn[:, :5])
    return Starts(points, normals, _in_turn(sights, count), weights, drawn, key)


def _in_turn(sights: Array, count: int) -> Array:
    """Return a line of sight ``(path, 3)`` for every path, or none."""
    if not len(sights):
        return sights
    return directions_to_block(sights[np.arange(count) % len(sights)])


def patch_points(scene: Scene, block: Block, patch: int, count: int, seed: int = 0) -> Starts:
    """Return points spread over a patch of the coating, pressed or not."""
    columns, rows = patch_counts(scene)
    key = PATCH_KEY + (seed << 20) + patch
    drawn = spread_points(range(count), 7, key)
    x = scene.pad.width * ((patch % columns + drawn[:, 5]) / columns - 0.5)
    y = scene.pad.length * ((patch // columns + drawn[:, 6]) / rows - 0.5)
    angle = block.kappa * (y - scene.camera.pivot)
    flat = y - scene.camera.pivot
    # Just above the lower face or a window, and straight up from there.
    depth = 0.999 * scene.pad.thickness
    sag = 0.5 * block.kappa * flat**2 * np.sinc(angle / (2 * np.pi)) ** 2
    start = np.stack(
        [x, flat * np.sinc(angle / np.pi) + depth * np.sin(angle), depth * np.cos(angle) - sag],
        axis=-1,
    )
    up = np.stack([np.zeros_like(x), -np.sin(angle), -np.cos(angle)], axis=-1)
    points, normals, weights = np.zeros((count, 3)), np.zeros((count, 3)), np.zeros(count)
    find_coating(block, start, up, points, normals, weights)
    weights *= skin_stretch(scene, x, y)
    drawn = np.ascontiguousarray(drawn[:, :5])
    return Starts(points, normals, NO_SIGHTS, weights / max(weights.sum(), 1.0), drawn, key)


def gathered(
    starts: Starts,
    block: Block,
    grid: FaceGrid | None,
    patches: int,
    orthonormal: Array | None = None,
) -> Halved[Gathered]:
    """Return what ``starts`` get of the exit field, if there is one, and of so many patches.

    ``orthonormal`` are the `orthonormal_terms` of ``grid``, made where they are not given.
    """
    ends, half = np.zeros(patches), len(starts.points) // 2
    out = np.zeros((0, 0, 1) if grid is None else (cell_count(grid), term_count(grid), 1))

    def follow(paths: slice) -> None:
        gather(
            block, grid or NO_GRID, starts.points[paths], starts.normals[paths],
            starts.sights[paths], starts.weights[paths], starts.drawn[paths], starts.key,
            paths.start, out, ends,
        )  # fmt: skip

    follow(slice(0, half))
    first_out, first_ends = out.copy(), ends.copy()
    follow(slice(half, len(starts.points)))
    terms = [out, 2.0 * first_out - out]
    if grid is not None:
        orthonormal = orthonormal_terms(grid) if orthonormal is None else orthonormal
        terms = [orthonormal @ each for each in terms]
    return Halved(
        Gathered(terms[0].ravel(), ends), Gathered(terms[1].ravel(), 2.0 * first_ends - ends)
    )
