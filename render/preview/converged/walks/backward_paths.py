"""Light followed backwards from the coating, to the layer and to the coating again.

The weights are those of radiance over the index squared (Veach 1997, eq. 5.3).
"""

from __future__ import annotations

import math

import numpy as np

from render.arrays import Array
from render.compiled import compiled
from render.preview.converged.walks.crossings import (
    BASE,
    BOND,
    COATING,
    FACET,
    Block,
    coating_normal,
    cross_clear,
    face_normal,
    patch_of,
)
from render.preview.converged.walks.faces import (
    index_of,
    meet_bond,
    reflect_inside,
    reflect_lobe,
    turn,
)
from render.preview.converged.walks.layer import MAX_EVENTS, FaceGrid, deposit, walk_layer
from render.preview.converged.walks.splitmix import begin_stream, uniform


@compiled
def find_coating(
    block: Block, origin: Array, direction: Array, points: Array, normals: Array, weights: Array
) -> None:
    """Write where rays ``(ray, 3)`` in the pad meet the coating: point, normal into the pad.

    Rays begin above a window. Weights ``(ray,)`` become 1, or 0 where a ray meets something else
    first.
    """
    p, d = np.empty(3), np.empty(3)
    for ray in range(len(origin)):
        p[:] = origin[ray]
        d[:] = direction[ray]
        way, face, site, facet = cross_clear(block, False, p, d)
        weights[ray] = 1.0 if face in (COATING, FACET) else 0.0
        for k in range(3):
            points[ray, k] = p[k] + way * d[k]
        if face == FACET:
            normals[ray] = block.normal[site, facet]
        else:
            coating_normal(block, points[ray], normals[ray])


@compiled
def gather(
    block: Block, grid: FaceGrid, points: Array, normals: Array, sights: Array, weights: Array,
    drawn: Array, key: int, number: int, out: Array, patches: Array,
) -> None:  # fmt: skip
    """Follow light backwards from points of the coating ``(path, 3)`` to the layer and to itself.

    Directions at the points are cosine distributed; ``drawn`` ``(path, 5)`` in [0, 1) draws them
    and the first reflection. With lines of sight ``(path, 3)`` onto the points (else none) they
    are those of the coating and its lobe. Where a path enters the layer, the light that leaves
    there is added to ``out`` ``(cell, term, 1)``, which may have no cells; where it meets the
    coating, its weight to ``patches`` ``(patch,)``. There it ends, unless the lobe sends it on.
    ``number`` is that of the first path.
    """
    state, powers, one = np.zeros(1, np.uint64), np.empty((2, grid.degree + 1)), np.empty(1)
    p, d, n, m = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for path in range(len(points)):
        weight = weights[path]
        if weight == 0.0:
            continue
        begin_stream(state, key, number + path)
        p[:] = points[path]
        d[:] = normals[path]
        if len(sights) == 0:
            turn(d, math.sqrt(1.0 - drawn[path, 0]), 2.0 * math.pi * drawn[path, 1])
        else:
            share, u = block.skin[1] / (block.skin[0] + block.skin[1]), drawn[path, 0]
            if u < share:
                d[:] = sights[path]
                weight *= reflect_lobe(block, d, normals[path], u / share, drawn[path, 1], m)
                if weight == 0.0:
                    continue
            else:
                u = (u - share) / (1.0 - share)
                turn(d, math.sqrt(1.0 - u), 2.0 * math.pi * drawn[path, 1])
        first, below = True, False
        for _ in range(MAX_EVENTS):
            way, face, site, facet = cross_clear(block, below, p, d)
            for k in range(3):
                p[k] += way * d[k]
            if face in (COATING, FACET):
                patches[patch_of(block, p)] += weight
                if block.skin[1] == 0.0 or uniform(state) >= block.skin[1]:
                    break
                if face == FACET:
                    n[:] = block.normal[site, facet]
                else:
                    coating_normal(block, p, n)
                weight *= reflect_lobe(block, d, n, uniform(state), uniform(state), m)
                if weight == 0.0:
                    break
                continue
            if face == BOND:
                below = meet_bond(block, below, d, uniform(state))
            elif face <= BASE and block.rims[face] > 0.0:
                if len(out):
                    one[0] = weight
                    deposit(block, grid, face, p, d, -1.0, one, powers, out)
                left, face, _ = walk_layer(state, block, p, d, n, m)
                weight *= left
            else:
                face_normal(block, face, p, n)
                for k in range(3):
                    n[k] = -n[k]
                if first:
                    u, v, chance = drawn[path, 2], drawn[path, 3], drawn[path, 4]
                else:
                    u, v, chance = uniform(state), uniform(state), uniform(state)
                index = index_of(block, below)
                weight *= reflect_inside(block, face, index, d, n, u, v, chance, m)
                first = False
            if weight == 0.0:
                break
