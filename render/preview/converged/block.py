"""The bent block of a scene as compiled light paths see it, and the cells on its inner faces."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from render.arrays import Array
from render.geometry import curvature, facets, fiber_poses
from render.preview.converged.walks import (
    BASE,
    END,
    LEFT,
    LOWER,
    NONE,
    OUTER_LEFT,
    OUTER_RIGHT,
    RIGHT,
    START,
    TIP,
    Block,
    FaceGrid,
)
from render.preview.diffuser.cache import hides_lamps
from render.scene import Scene

FACES = ((LEFT, OUTER_LEFT), (TIP, END), (RIGHT, OUTER_RIGHT), (BASE, START), (LOWER,))
"""Numbers in the walks of the faces that a scene names; an edge has two, with and without layer."""
CELL_SIDE = 0.25
"""Side of a cell on the inner faces, in thicknesses of the pad; light is linear within it."""
MAX_COLUMNS = 64
"""Cells along an edge at most."""
DEGREE = 3
"""Degree of the polynomials in the direction."""
SAG_STEP, MAX_SAGS = 0.1, 513
"""Distance of the grid of a skin that is not flat, mm, and its places along a side at most."""
LEAST_CURVATURE = 1e-6
"""Curvature of such a skin at least, 1/mm: what a ray's steps are divided by."""
PATCH_SIDE, MAX_PATCHES = 0.5, 320
"""Side of a patch of the coating in thicknesses of the pad; and how many there are at most."""
PATCH_WIDTHS = 2.0
"""Side of a patch in widths of the narrowest beam at most."""


PLACES = 4
"""Places along a side of a patch at which its slope is asked."""


def to_block(scene: Scene, points: Array) -> Array:
    """Return world positions ``(..., 3)`` in the frame of `render.preview.converged.walks`."""
    return (points - [0.0, scene.camera.pivot, scene.pad.thickness]) * [1.0, 1.0, -1.0]


def directions_to_block(directions: Array) -> Array:
    """Return world directions ``(..., 3)`` in the frame of `render.preview.converged.walks`."""
    return np.ascontiguousarray(directions * [1.0, 1.0, -1.0])


def bent_block(scene: Scene, bend: float, pressed: bool) -> Block:
    """Return the block at ``bend`` rad, pressed by the pyramids at all sites or untouched."""
    pad, layer, kappa = scene.pad, scene.diffuser, curvature(scene, bend)
    window = scene.window
    depth = pad.thickness if window is None else pad.thickness + window.thickness
    half_length, rims = pad.length / 2, np.array(scene.box.rims)
    alpha, paint = np.full(NONE + 1, pad.roughness), np.full((NONE + 1, 2), -1.0)
    for faces, finish in zip(FACES, scene.finishes, strict=True):
        for face in faces:
            alpha[face] = finish.roughness
            if finish.paint is not None:
                paint[face] = finish.paint.reflectance, float(finish.paint.mirror)

    def plane(y: float) -> Array:
        flat = y - scene.camera.pivot
        angle = kappa * flat
        return np.array([np.cos(angle), np.sin(angle), flat * np.sinc(angle / np.pi)])

    shape = facets(scene, bend)
    count = scene.sites.count if pressed else 0
    normal = directions_to_block(shape.normal)[:count]
    corner = to_block(scene, shape.corners[:count, :, 0])
    columns, rows = patch_counts(scene)
    sag, sinks = skin_sag(scene)
    return Block(
        kappa=kappa,
        level=depth * (1.0 + 0.5 * kappa * depth),
        half_width=pad.width / 2,
        rims=rims,
        base=plane(-half_length),
        tip=plane(half_length),
        start=plane(-half_length - rims[BASE]),
        end=plane(half_length + rims[TIP]),
        index=pad.index,
        bond=np.inf if window is None else pad.thickness,
        window=pad.index if window is None else window.index,
        alpha=alpha,
        paint=paint,
        sigma_s=layer.sigma_s if layer else 0.0,
        sigma_a=layer.sigma_a if layer else 0.0,
        g=layer.g if layer else 0.0,
        wide=wide_from(scene),
        sites=to_block(scene, shape.site_position[:count]),
        reach=1.001 * max(scene.indenter.radius, scene.indenter.depth),
        normal=np.ascontiguousarray(normal),
        offset=np.einsum("sfi,sfi->sf", normal, corner),
        patch=np.array([columns, rows, half_length, scene.camera.pivot], dtype=np.float64),
        skin=np.array([scene.albedos[0], *(scene.coating.lobe or (0.0, 1.0))]),
        sag=sag,
        sinks=sinks,
    )


def skin_sag(scene: Scene) -> tuple[Array, Array]:
    """Return ``sag`` and ``sinks`` of the block: of a skin that is not flat, else empty and 0."""
    skin, pad = scene.skin, scene.pad
    if skin is None:
        return np.zeros((0, 0, 3)), np.zeros(2)
    x, y = (
        np.linspace(-0.5 * side, 0.5 * side, min(math.ceil(side / SAG_STEP) + 1, MAX_SAGS))
        for side in (pad.width, pad.length)
    )
    at = np.meshgrid(x, y)
    sag = -np.stack([skin.rise(*at), *skin.slope(*at)], axis=-1)
    along_x, along_y = (
        np.abs(np.diff(sag[..., 1:], axis=axis)).sum(axis=-1) / np.diff(lines)[0]
        for axis, lines in ((1, x), (0, y))
    )
    # The largest curvature is at most the larger sum of a row of second derivatives.
    sharpest = max(float(along_x.max()), float(along_y.max()), LEAST_CURVATURE)
    return np.ascontiguousarray(sag), np.array([sag[..., 0].max(), sharpest])


def wide_from(scene: Scene) -> int:
    """Return how often light is scattered until it is wide enough for the exit field's terms.

    Behind an opaque layer all of it is; elsewhere as often as leaves a mean cosine of 1/e,
    ``g^n`` with ``n = 1 / (1 - g)``.
    """
    layer = scene.diffuser
    if layer is None or hides_lamps(scene):
        return 0
    return math.ceil(1.0 / (1.0 - abs(layer.g)))


def beam_cones(scene: Scene) -> Array:
    """Return the angle (rad) from its axis at which the light of each lamp ends, ``(lamp,)``.

    A Gaussian profile has its ``sigma_v`` there; straight, before it is refracted.
    """
    angle = np.linspace(0.0, np.pi / 2, 901)[:-1]
    cones = []
    for lamp in scene.placed_lamps():
        intensity = lamp.profile.radiance(angle) * np.cos(angle)
        cones.append(angle[intensity > np.exp(-0.25) * intensity.max()].max())
    return np.array(cones)


@lru_cache(maxsize=64)
def beam_widths(scene: Scene) -> Array:
    """Return how wide (mm) the light of each lamp is where it first gets to a site, ``(lamp,)``.

    That is the radius of its end and, in quadrature, that of its cone (`beam_cones`); straight, on
    the flat pad.
    """
    bend = scene.bending.angles[0]
    away = facets(scene, bend).site_position - fiber_poses(scene, bend).position[:, None]
    radius = np.array([0.5 * lamp.diameter for lamp in scene.placed_lamps()])
    return np.asarray(
        np.hypot(radius, beam_cones(scene) * np.linalg.norm(away, axis=-1).min(axis=1))
    )


def on_pad(scene: Scene, uv: Array) -> Array:
    """Return places of the coating ``(..., 2)``, mm; those beyond its sides at the nearest side."""
    half = 0.5 * np.array([scene.pad.width, scene.pad.length]) * (1.0 - 1e-4)
    return np.clip(uv, -half, half)


def patch_counts(scene: Scene) -> tuple[int, int]:
    """Return columns and rows of the coating's patches: as fine as the narrowest beam asks."""
    pad = scene.pad
    side = min(PATCH_SIDE * pad.thickness, PATCH_WIDTHS * float(beam_widths(scene).min()))
    side = max(side, np.sqrt(pad.width * pad.length / MAX_PATCHES))
    return int(np.ceil(pad.width / side)), int(np.ceil(pad.length / side))


def patch_areas(scene: Scene) -> Array:
    """Return the areas of the patches of the untouched coating ``(patch,)``, mm^2."""
    columns, rows = patch_counts(scene)
    flat = scene.pad.width * scene.pad.length / (columns * rows)
    if scene.skin is None:
        return np.full(columns * rows, flat)
    within = (np.arange(PLACES) + 0.5) / PLACES
    x, y = (
        side * ((np.arange(count)[:, None] + within) / count - 0.5)
        for side, count in ((scene.pad.width, columns), (scene.pad.length, rows))
    )
    stretch = skin_stretch(scene, x[None, None], y[:, :, None, None])
    return np.asarray(flat * stretch.mean(axis=(1, 3)).ravel())


def skin_stretch(scene: Scene, x: Array, y: Array) -> Array:
    """Return the area of the untouched coating at flat places over that of the flat pad."""
    if scene.skin is None:
        return np.ones(np.broadcast_shapes(x.shape, y.shape))
    along_x, along_y = scene.skin.slope(x, y)
    return np.asarray(np.sqrt(1.0 + along_x**2 + along_y**2))


def face_grid(scene: Scene, degree: int = DEGREE) -> FaceGrid:
    """Return the cells on the inner faces of the layer."""
    pad = scene.pad
    sides = np.array([pad.length, pad.width, pad.length, pad.width])
    columns = np.ceil(sides / (CELL_SIDE * pad.thickness)).astype(np.int64)
    columns = np.clip(columns, 4, MAX_COLUMNS)
    columns[np.array(scene.box.rims) == 0.0] = 0
    return FaceGrid(
        first=np.concatenate([[0], np.cumsum(columns)])[:-1],
        columns=columns,
        half=sides / 2,
        rows=round(1 / CELL_SIDE),
        thickness=pad.thickness,
        degree=degree,
    )


def cell_count(grid: FaceGrid) -> int:
    """Return the number of cells on the inner faces."""
    return int(grid.columns.sum()) * grid.rows


def cell_areas(grid: FaceGrid) -> Array:
    """Return the area of every cell, mm^2."""
    side = np.repeat(2 * grid.half / np.maximum(grid.columns, 1), grid.columns * grid.rows)
    return np.asarray(side * grid.thickness / grid.rows)


def term_count(grid: FaceGrid) -> int:
    """Return how many terms a cell has."""
    return 4 * (grid.degree + 1) ** 2


def orthonormal_terms(grid: FaceGrid) -> Array:
    """Return ``(cell, term, term)``: what turns a cell's terms into orthonormal ones.

    Orthonormal over the cell's area and its directions weighed by the cosine c, so that the power
    that a light field L brings to a sensitivity W is the sum over terms of their products:
    ``integral L W c = sum_i <L, f_i> <W, f_i>``.
    """
    degree = grid.degree
    monomials = [
        (i, j, part)
        for part in range(2)
        for i in range(degree + 1 - part)
        for j in range(degree + 1 - part - i)
    ]
    moments = np.array([[_moment(a, b) for b in monomials] for a in monomials])
    angular = np.linalg.inv(np.linalg.cholesky(moments))
    # Over a cell of unit area 1, x, z and x z have the norms 1, 1/sqrt 3, 1/sqrt 3 and 1/3.
    place = np.array([1.0, np.sqrt(3.0), np.sqrt(3.0), 3.0])
    one = np.einsum("st,ab->satb", angular, np.diag(place))
    one = one.reshape(2 * (len(place) * len(angular),))
    return np.asarray(one / np.sqrt(cell_areas(grid))[:, None, None])


def _moment(first: tuple[int, int, int], second: tuple[int, int, int]) -> float:
    """Return the integral of two monomials ``a^i b^j c^k`` times c over the half sphere c > 0."""
    i, j, k = (a + b for a, b in zip(first, second, strict=True))
    if i % 2 or j % 2:
        return 0.0
    # Folland 2001: over the whole sphere it is twice the product of gammas over that of the sum.
    halves = [(power + 1) / 2 for power in (i, j, k + 1)]
    return math.prod(math.gamma(half) for half in halves) / math.gamma(sum(halves))
