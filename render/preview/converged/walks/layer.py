"""Light in the diffusive layer, and what of it leaves through an inner face.

Analog walks (Henyey and Greenstein's phase function) between the layer's faces; light that leaves
is projected onto polynomials in place and direction, in cells on the inner faces.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from render.arrays import Array
from render.compiled import compiled
from render.preview.converged.walks.crossings import (
    BASE,
    LEFT,
    NONE,
    RIGHT,
    TIP,
    Block,
    angle_of,
    cross_layer,
    enter_block,
    face_normal,
    in_layer,
    level_of,
    within,
)
from render.preview.converged.walks.faces import reflect_inside, refract_into, turn
from render.preview.converged.walks.splitmix import State, begin_stream, uniform

MAX_EVENTS = 100_000
"""Events after which a path counts as lost: only light that circles without loss gets there."""


class FaceGrid(NamedTuple):
    """Cells on the layer's inner faces, in each of which light is a polynomial.

    Per cell: degree 1 along the edge times degree 1 upwards times the monomials
    ``a^i b^j (i + j <= degree)`` and ``c a^i b^j (i + j < degree)`` of the direction (a along the
    edge, b to the coating, c into the pad): ``4 (degree + 1)^2`` terms, not yet orthonormal.

    Arguments:
        first: ``(4,)`` number of each edge's first column of cells.
        columns: ``(4,)`` how many there are along each edge; 0 where no layer lies on it.
        half: ``(4,)`` half the length of each edge.
        rows: cells above each other.
        thickness: of the pad.
        degree: in the direction.
    """

    first: NDArray[np.int64]
    columns: NDArray[np.int64]
    half: Array
    rows: int
    thickness: float
    degree: int


@compiled
def walk_layer(
    state: State, block: Block, p: Array, d: Array, n: Array, m: Array
) -> tuple[float, int, int]:
    """Walk in the layer until light leaves it through an inner face.

    Return its weight, the face, and how often it was scattered. Weight 0: it was absorbed or left
    into the air.
    """
    extinction, weight, scattered = block.sigma_s + block.sigma_a, 1.0, 0
    for _ in range(MAX_EVENTS):
        free = math.inf
        if extinction > 0.0:
            free = -math.log(1.0 - uniform(state)) / extinction
        way, face = cross_layer(block, p, d)
        step = min(way, free)
        for k in range(3):
            p[k] += step * d[k]
        if free < way:
            if uniform(state) * extinction >= block.sigma_s:
                return 0.0, NONE, scattered
            scattered += 1
            u, g = uniform(state), block.g
            cos = 2.0 * u - 1.0
            if abs(g) > 1e-3:
                ratio = (1.0 - g * g) / (1.0 - g + 2.0 * g * u)
                cos = (1.0 + g * g - ratio * ratio) / (2.0 * g)
            turn(d, max(-1.0, min(1.0, cos)), 2.0 * math.pi * uniform(state))
        elif face <= BASE:
            if face in (LEFT, RIGHT):
                p[0] = -block.half_width if face == LEFT else block.half_width
            return weight, face, scattered
        else:
            face_normal(block, face, p, n)
            for k in range(3):
                n[k] = -n[k]
            u, v, chance = uniform(state), uniform(state), uniform(state)
            weight *= reflect_inside(block, face, block.index, d, n, u, v, chance, m)
            if weight == 0.0:
                return 0.0, NONE, scattered
    return 0.0, NONE, scattered


@compiled
def deposit(
    block: Block, grid: FaceGrid, face: int, p: Array, d: Array, sign: float, weights: Array,
    powers: Array, out: Array,
) -> None:  # fmt: skip
    """Add light that crosses an inner face to ``out`` ``(cell, term, weight)``.

    ``sign * d`` points into the pad; ``weights`` ``(weight,)``; ``powers`` is scratch
    ``(2, degree + 1)``.
    """
    sine, cosine, flat = angle_of(block, p)
    tangent = sign * (d[1] * cosine - d[2] * sine)
    up = -sign * (d[1] * sine + d[2] * cosine)
    level = max(0.0, level_of(block, p))
    depth = 2.0 * level / (1.0 + math.sqrt(1.0 + 2.0 * block.kappa * level))
    height = 1.0 - depth / grid.thickness
    along, into, s = tangent, abs(d[0]), (flat + block.patch[3]) / grid.half[face]
    scale = 1.0
    if face in (TIP, BASE):
        along, s = sign * d[0], p[0] / grid.half[face]
        into = -tangent if face == TIP else tangent
    else:
        # The face is wider below the coating: both factors of a product get half of it.
        scale = 1.0 / math.sqrt(1.0 + block.kappa * depth)
    columns = grid.columns[face]
    place = 0.5 * (s + 1.0) * columns
    column = min(columns - 1, max(0, int(place)))
    xi = 2.0 * (place - column) - 1.0
    place = height * grid.rows
    row = min(grid.rows - 1, max(0, int(place)))
    zeta = 2.0 * (place - row) - 1.0
    cell = (grid.first[face] + column) * grid.rows + row
    degree = grid.degree
    powers[:, 0] = 1.0
    for i in range(degree):
        powers[0, i + 1] = powers[0, i] * along
        powers[1, i + 1] = powers[1, i] * up
    term = 0
    for part in range(2):
        for i in range(degree + 1 - part):
            for j in range(degree + 1 - part - i):
                value = scale * powers[0, i] * powers[1, j] * (into if part else 1.0)
                for weight in range(len(weights)):
                    share = value * weights[weight]
                    out[cell, term, weight] += share
                    out[cell, term + 1, weight] += share * xi
                    out[cell, term + 2, weight] += share * zeta
                    out[cell, term + 3, weight] += share * xi * zeta
                term += 4


@compiled
def trace_lamp(
    block: Block, grid: FaceGrid, origin: Array, direction: Array, weights: Array, repeats: int,
    key: int, number: int, out: Array,
) -> None:  # fmt: skip
    """Follow rays of a lamp ``(ray, 3)`` until they leave the layer, and add them to ``out``.

    Each is followed ``repeats`` times; ``number`` is that of the first such walk.

    ``weights`` ``(ray, node)``; ``out`` ``(cell, term, node)``. Light that enters the clear pad is
    left out. Rays of a lamp in the layer begin there.
    """
    state, powers = np.zeros(1, np.uint64), np.empty((2, grid.degree + 1))
    p, d, n, m = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    scaled = np.empty(weights.shape[1])
    for ray in range(repeats * len(origin)):
        begin_stream(state, key, number + ray)
        p[:] = origin[ray // repeats]
        d[:] = direction[ray // repeats]
        passed = 1.0
        if not within(block, p):
            face = enter_block(block, p, d)
            if face == NONE or block.paint[face, 0] >= 0.0:
                continue
            face_normal(block, face, p, n)
            u, v = uniform(state), uniform(state)
            passed = refract_into(block, face, block.index, d, n, u, v, m)
            if passed == 0.0:
                continue
        if not in_layer(block, p):
            continue
        left, face, scattered = walk_layer(state, block, p, d, n, m)
        if left > 0.0 and scattered >= block.wide:
            for node in range(len(scaled)):
                scaled[node] = passed * left * weights[ray // repeats, node] / repeats
            deposit(block, grid, face, p, d, 1.0, scaled, powers, out)
