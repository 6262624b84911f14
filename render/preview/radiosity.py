"""Light that goes to and fro in the pad before the camera sees it: radiosity between patches.

The coating, the diffuser's inner faces and white walls reflect diffusely; patches see each other
straight and by way of the lower face, which reflects totally beyond the critical angle. With
irradiance ``E0`` straight from the lights, ``E = E0 + K rho E`` (Goral et al. 1984), solved once
per bend.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from render.arrays import Array
from render.geometry import curvature
from render.preview.light_paths import (
    LightPath,
    Turns,
    direct_path,
    face_reflects,
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
        part = 0.5 * (1 + self.points.normal[: self.points.facets, 2])
        return np.asarray(part * self.scene.coating.albedo * around)


def solve_radiosity(
    scene: Scene, points: ShadingPoints, bend: float, edge_albedo: float
) -> Radiosity:
    """Solve the patches' radiosity at ``bend`` radians.

    ``edge_albedo`` is that of the diffuser for light from inside the pad.
    """
    kernel = np.concatenate(
        [
            _kernel(scene, points, bend, slice(first, first + TARGETS))
            for first in range(0, len(points.position), TARGETS)
        ]
    )
    white = [finish.paint.reflectance if finish.paint else edge_albedo for finish in scene.finishes]
    on_coating = np.full(points.columns * points.rows, scene.coating.albedo)
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
    on_edge = np.arange(len(points.position))[chosen] >= points.first_edge
    parts = []
    for first, last in (
        (points.first_patch, points.first_edge),
        (points.first_edge, len(points.position)),
    ):
        # The coating is flat or convex: only edges see it straight.
        sees = slice(None) if first == points.first_edge else on_edge
        source, normal, area = _spots(points, slice(first, last))
        part = np.zeros((len(target), *source.shape[1:3]))
        seen_in: list[tuple[Any, Array, Array, Turns]] = [(slice(None), source, normal, (0, 0))]
        for wall in wall_images(scene):
            near = wall.distance(points.position[first:last]) < near_wall(scene)
            if near.any():
                flipped = normal[:, near] * wall.flip
                seen_in.append((near, wall.image(source[:, near]), flipped, wall.turns))
        for seen, place, turned, turns in seen_in:
            mirrored = mirrored_path(place, target, thickness, kappa)
            part[:, seen] += face_reflects(scene, mirrored.cosine) * _coupling(
                scene, mirrored, turned, facing, turns
            )
            direct = direct_path(place, target[sees], thickness, kappa)
            straight = np.zeros_like(part[:, seen])
            straight[sees] = _coupling(scene, direct, turned, facing[sees], turns)
            part[:, seen] += straight
        parts.append((part * area).mean(axis=2))
    return np.concatenate(parts, axis=1)


def _spots(points: ShadingPoints, chosen: slice) -> tuple[Array, Array, Array]:
    """Return points ``(1, patch, spot, 3)`` on patches, normals, and areas ``(1, patch, 1)``."""
    position, size = points.position[chosen], points.size[chosen]
    normal = points.normal[chosen]
    first = np.where(np.abs(normal[:, :1]) > 0.5, [[0.0, 1.0, 0.0]], [[1.0, 0.0, 0.0]])
    second = np.where(np.abs(normal[:, 2:]) > 0.5, [[0.0, 1.0, 0.0]], [[0.0, 0.0, 1.0]])
    u, v = (part.ravel() for part in np.meshgrid(_SPOTS, _SPOTS))
    spots = position[:, None] + (
        u[:, None] * (size[:, :1] * first)[:, None] + v[:, None] * (size[:, 1:] * second)[:, None]
    )
    return spots[None], normal[None, :, None], size.prod(axis=1)[None, :, None]


def _coupling(scene: Scene, path: LightPath, normal: Array, facing: Array, turns: Turns) -> Array:
    """Return irradiance per radiosity and area: both cosines, 1 / (pi d^2).

    Light of an image is what the walls reflect on its ``turns`` along x and y.
    """
    leaves = np.maximum(np.sum(path.depart * normal, axis=-1), 0.0)
    lands = np.maximum(np.sum(path.arrive * facing, axis=-1), 0.0)
    result = leaves * lands * path.spread / np.pi
    return np.asarray(result * walls_reflect(scene, turns, path.depart))
