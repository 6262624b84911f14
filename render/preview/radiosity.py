"""Light that goes to and fro in the pad before the camera sees it: radiosity between patches.

The coating, the diffuser's inner faces and white walls reflect diffusely; patches see each other
straight and by way of the lower face, which reflects totally beyond the critical angle. What a lobe
of the coating sends out counts as diffuse. A skin that is not flat sees itself straight as well.
With irradiance ``E0`` straight from the lights, ``E = E0 + K rho E`` (Goral et al. 1984), solved
once per bend.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from render.arrays import Array
from render.geometry import SkinChart, curvature
from render.preview.light_paths import (
    LightPath,
    Turns,
    direct_path,
    face_reflects,
    meets_edges,
    mirrored_path,
    near_wall,
    wall_images,
    walls_reflect,
)
from render.preview.shading_points import ShadingPoints
from render.scene import Scene

TARGETS = 1000
"""Points that gather light at a time, which bounds the memory."""
# Gauss points: each patch sends its light from 2 x 2 points.
_SPOTS = np.array([-0.5, 0.5]) / np.sqrt(3)


@dataclass(frozen=True)
class Radiosity:
    """What light to and fro in the pad adds to direct irradiance at one bend.

    indirect: ``(target, patch)``, irradiance on facets, sites and coating patches (in the order of
    `ShadingPoints`) per direct irradiance on all patches.
    """

    scene: Scene
    points: ShadingPoints
    indirect: Array

    def added(self, direct: Array) -> Array:
        """Return the indirect irradiance ``(row, target)`` for the direct one ``(row, point)``."""
        return np.asarray(direct[:, self.points.first_patch :] @ self.indirect.T)

    def below(self, around: Array) -> Array:
        """Return what the coating around facets adds to them, ``(..., facet)``.

        ``around`` is its irradiance there. It fills the part of a facet's sky that lies below the
        coating's plane.
        """
        facets = slice(0, self.points.sites * self.points.facets)
        cosine = -np.sum(self.points.normal[facets] * self.points.below[facets], axis=-1)
        part = 0.5 * (1 + cosine.reshape(self.points.sites, self.points.facets))
        return np.asarray(part * self.scene.coating.reflectance * around)


def form_factors(scene: Scene, points: ShadingPoints, bend: float) -> Array:
    """Return the irradiance at all points per radiosity of every patch, ``(point, patch)``.

    It is the same for every albedo.
    """
    return np.concatenate(
        [
            _kernel(scene, points, bend, slice(first, first + TARGETS))
            for first in range(0, len(points.position), TARGETS)
        ]
    )


def solve_radiosity(
    scene: Scene,
    points: ShadingPoints,
    bend: float,
    edge_albedo: float,
    factors: Array | None = None,
) -> Radiosity:
    """Solve the patches' radiosity at ``bend`` radians, in the light of one albedo.

    ``edge_albedo`` is that of the diffuser for light from inside the pad; ``factors`` are the
    `form_factors`, where they are known.
    """
    kernel = form_factors(scene, points, bend) if factors is None else factors
    white = [finish.paint.reflectance if finish.paint else edge_albedo for finish in scene.finishes]
    on_coating = np.full(points.columns * points.rows, scene.coating.reflectance)
    albedo = np.concatenate([on_coating, np.array(white)[points.edge]])
    between = kernel[points.first_patch :] * albedo
    gather = kernel[: points.first_edge] * albedo
    # E = E0 + between E, and targets gather from the final irradiance.
    solved = np.linalg.solve((np.eye(len(between)) - between).T, gather.T).T
    return Radiosity(scene, points, solved)


def _kernel(scene: Scene, points: ShadingPoints, bend: float, chosen: slice) -> Array:
    """Return the irradiance at chosen points per radiosity of every patch, ``(point, patch)``."""
    kappa, thickness = curvature(scene, bend), scene.pad.thickness
    target, facing = points.position[chosen, None, None], points.normal[chosen, None, None]
    ground = points.ground[chosen, None, None]
    on_edge = np.arange(len(points.position))[chosen] >= points.first_edge
    parts = []
    for first, last in (
        (points.first_patch, points.first_edge),
        (points.first_edge, len(points.position)),
    ):
        # A coating that is flat or rolled: only edges see it straight.
        everything = first == points.first_edge or scene.skin is not None
        sees = slice(None) if everything else on_edge
        # What facets see of the skin around them is in `Radiosity.below`.
        seen_from = ground if first == points.first_patch else target
        source, normal, area = _spots(scene, points, slice(first, last))
        part = np.zeros((len(target), *source.shape[1:3]))
        seen_in: list[tuple[Any, Array, Array, Turns]] = [(slice(None), source, normal, (0, 0))]
        for wall in wall_images(scene):
            near = wall.distance(points.position[first:last]) < near_wall(scene)
            if near.any():
                flipped = normal[:, near] * wall.flip
                seen_in.append((near, wall.image(source[:, near]), flipped, wall.turns))
        for seen, place, turned, turns in seen_in:
            mirrored = mirrored_path(place, target, thickness, kappa)
            below = place * [1.0, 1.0, -1.0]
            part[:, seen] += (
                face_reflects(scene, mirrored.cosine)
                * _coupling(scene, mirrored, turned, facing, turns)
                * meets_edges(scene, below, target, turns)
            )
            direct = direct_path(place, seen_from[sees], thickness, kappa)
            straight = np.zeros_like(part[:, seen])
            straight[sees] = _coupling(scene, direct, turned, facing[sees], turns)
            straight[sees] *= meets_edges(scene, place, seen_from[sees], turns)
            part[:, seen] += straight
        parts.append((part * area).mean(axis=2))
    return np.concatenate(parts, axis=1)


def _spots(scene: Scene, points: ShadingPoints, chosen: slice) -> tuple[Array, Array, Array]:
    """Return points ``(1, patch, spot, 3)`` on patches, normals, and areas ``(1, patch, 1)``."""
    position, size = points.position[chosen], points.size[chosen]
    normal = points.normal[chosen]
    on_skin = scene.skin is not None and chosen.start == points.first_patch
    first = np.where(np.abs(normal[:, :1]) > 0.5, [[0.0, 1.0, 0.0]], [[1.0, 0.0, 0.0]])
    second = np.where(np.abs(normal[:, 2:]) > 0.5, [[0.0, 1.0, 0.0]], [[0.0, 0.0, 1.0]])
    if on_skin:
        first, second = np.eye(3)[:1], np.eye(3)[1:2]
    u, v = (part.ravel() for part in np.meshgrid(_SPOTS, _SPOTS))
    spots = position[:, None] + (
        u[:, None] * (size[:, :1] * first)[:, None] + v[:, None] * (size[:, 1:] * second)[:, None]
    )
    area = size.prod(axis=1)[None, :, None]
    if not on_skin:
        return spots[None], normal[None, :, None], area
    chart = SkinChart(scene, 0.0)
    inward = -chart.frames(spots[..., :2])[..., 2]
    return chart.flat(spots[..., :2])[None], inward[None], area / -inward[None, ..., 2]


def _coupling(scene: Scene, path: LightPath, normal: Array, facing: Array, turns: Turns) -> Array:
    """Return irradiance per radiosity and area: both cosines, 1 / (pi d^2).

    Light of an image is what the walls reflect on its ``turns`` along x and y.
    """
    leaves = np.maximum(np.sum(path.depart * normal, axis=-1), 0.0)
    lands = np.maximum(np.sum(path.arrive * facing, axis=-1), 0.0)
    result = leaves * lands * path.spread / np.pi
    return np.asarray(result * walls_reflect(scene, turns, path.depart))
