"""Camera rays inside the pad: refracted once at its smooth lower face, followed to the coating.

The lower face is the plane z = 0, or the arc of radius ``1 / curvature + thickness`` about the
bend axis when the pad is bent. Roughness spreads light about these rays; it does not move them.
Under a flat pad may lie a window: rays are refracted at its lower face too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from render.arrays import Array
from render.geometry.bending import curvature, distance_to_arc, unbend_points
from render.geometry.chart import SkinChart
from render.scene import Scene, Window


@dataclass(frozen=True)
class PadRays:
    """Rays inside the clear pad, world frame.

    entry: where they enter, ``(..., 3)`` mm; direction: ``(..., 3)`` unit vectors;
    inside: ``(...,)``, False where the ray misses the clear part of the lower face. Entry and
    direction mean nothing there.
    """

    entry: Array
    direction: Array
    inside: NDArray[np.bool_]

    def __getitem__(self, index: NDArray[np.bool_] | NDArray[np.int64]) -> PadRays:
        """Return the selected rays."""
        return PadRays(self.entry[index], self.direction[index], self.inside[index])


def refract_into_pad(scene: Scene, bend: float, origin: Array, directions: Array) -> PadRays:
    """Return the rays ``(..., 3)`` from ``origin`` after Snell refraction at the lower face."""
    if scene.window is not None:
        return _through_window(scene, scene.window, origin, directions)
    kappa = curvature(scene, bend)
    kappa_face = kappa / (1.0 + kappa * scene.pad.thickness)
    start = np.broadcast_to(origin - [0.0, scene.camera.pivot, 0.0], directions.shape)
    distance = distance_to_arc(kappa_face, start, directions)
    hit = np.isfinite(distance)
    local = start + np.where(hit, distance, 0.0)[..., None] * directions
    # The outward normal is the gradient of the arc's equation.
    normal = np.stack(
        [np.zeros_like(distance), kappa_face * local[..., 1], kappa_face * local[..., 2] - 1.0],
        axis=-1,
    )
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    ratio = 1.0 / scene.pad.index
    cos_in = -np.einsum("...i,...i->...", directions, normal)
    cos_out = np.sqrt(1.0 - ratio**2 * (1.0 - cos_in**2))
    refracted = ratio * directions + (ratio * cos_in - cos_out)[..., None] * normal
    entry = local + np.array([0.0, scene.camera.pivot, 0.0])
    flat = unbend_points(scene, entry, bend)
    on_pad = (np.abs(flat[..., 0]) <= scene.pad.width / 2) & (
        np.abs(flat[..., 1]) <= scene.pad.length / 2
    )
    return PadRays(entry, refracted, hit & on_pad)


def _through_window(scene: Scene, window: Window, origin: Array, directions: Array) -> PadRays:
    """Return the rays after refraction at both faces of the window; they enter the pad at z = 0."""
    rise = directions[..., 2]
    hit = rise > 0.0
    up = np.where(hit, rise, 1.0)[..., None]
    below = origin + directions * ((-window.thickness - origin[2]) / up)
    # What lies along the faces is the same on both sides, times the index.
    along = directions[..., :2]
    squared = (along**2).sum(axis=-1, keepdims=True)
    in_window = np.concatenate([along, np.sqrt(window.index**2 - squared)], axis=-1) / window.index
    entry = below + in_window * (window.thickness / in_window[..., 2:])
    entry[..., 2] = 0.0
    inside = np.concatenate([along, np.sqrt(scene.pad.index**2 - squared)], axis=-1)
    half = np.array([scene.pad.width, scene.pad.length]) / 2
    on_window = (np.abs(below[..., :2]) <= half).all(axis=-1)
    on_pad = (np.abs(entry[..., :2]) <= half).all(axis=-1)
    return PadRays(entry, inside / scene.pad.index, hit & on_window & on_pad)


AIM_STEPS, AIM_TOLERANCE = 60, 1e-6
"""Steps in which `aim_at` corrects its aim at most, and the miss (mm) that it is content with."""


def aim_at(
    scene: Scene, bend: float, origin: Array, points: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """Return the directions ``(n, 3)`` from ``origin`` that refraction leads to ``points``.

    ``points`` are inside the pad, ``(n, 3)`` mm. The aim is moved by what it missed, until it
    hits; the second array, ``(n,)``, says where it did.
    """
    aim = np.array(points, dtype=np.float64)
    for _ in range(AIM_STEPS):
        direction = aim - origin
        direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
        rays = refract_into_pad(scene, bend, origin, direction)
        along = np.einsum("ni,ni->n", points - rays.entry, rays.direction)
        miss = points - rays.entry - along[:, None] * rays.direction
        hit = np.linalg.norm(miss, axis=-1) < AIM_TOLERANCE
        if hit.all():
            break
        aim += miss
    return direction, hit & (along > 0)


def distance_to_coating(scene: Scene, bend: float, rays: PadRays) -> Array:
    """Return the way (mm) from entry to the untouched coating, ``inf`` where a ray passes it."""
    return SkinChart(scene, bend).way(rays.entry, rays.direction)
