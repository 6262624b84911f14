"""Bending: the flat pad rolled onto a circular arc of constant coating length.

Flat pad frame (mm): x across, y from base to tip, z from the camera-side face (0) to the coating
(thickness); the origin is the center of the camera-side face. The world frame of every bend is
the one in which the camera stands still: the pad rolls away from the plane that touches the
coating above the camera, so that light and camera stay where they are.
"""

from __future__ import annotations

import math

import numpy as np

from render.arrays import Array
from render.errors import SceneError
from render.scene import Scene


def curvature(scene: Scene, bend: float) -> float:
    """Return the curvature of the coating in 1/mm for a total bending angle in radians.

    Raises:
        SceneError: the skin does not bend, and ``bend`` is not 0.
    """
    if bend and scene.states is not None:
        raise SceneError(
            f"{bend:g} is no bend of {scene.name}, whose body is rigid: for the number of a state "
            "take the sensor in that state (render.geometry.in_state)",
            field="states",
        )
    if bend and scene.skin is not None:
        raise SceneError(
            f"bend = {math.degrees(bend):g} deg: a skin of skin.shape = {scene.skin.shape} does "
            "not bend, allowed with one: 0",
            field="bend",
        )
    return bend / scene.pad.length


def bend_points(scene: Scene, points: Array, bend: float) -> Array:
    """Return world positions (mm) of flat pad points, shape ``(..., 3)``, at ``bend`` radians.

    The coating keeps its length; a point ``w`` mm below it moves on the arc of radius
    ``1 / curvature + w``. Written with sinc so that bend 0 is exact and 1e-6 loses nothing.
    """
    kappa = curvature(scene, bend)
    u = points[..., 1] - scene.camera.pivot
    w = scene.pad.thickness - points[..., 2]
    angle = kappa * u
    # np.sinc(a / pi) = sin(a) / a, 1 at a = 0.
    y = scene.camera.pivot + u * np.sinc(angle / np.pi) + w * np.sin(angle)
    sag = 0.5 * kappa * u**2 * np.sinc(angle / (2 * np.pi)) ** 2
    z = scene.pad.thickness + sag - w * np.cos(angle)
    return np.stack([points[..., 0], y, z], axis=-1)


def bend_frames(scene: Scene, y: Array, bend: float) -> Array:
    """Return rotations ``(..., 3, 3)`` that turn flat pad directions at ``y`` (mm) into world ones.

    Column 0 is across (+x), column 1 the tangent towards the tip, column 2 towards the coating.
    """
    angle = curvature(scene, bend) * (np.asarray(y) - scene.camera.pivot)
    cos, sin, zero, one = np.cos(angle), np.sin(angle), np.zeros_like(angle), np.ones_like(angle)
    rows = [[one, zero, zero], [zero, cos, -sin], [zero, sin, cos]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def unbend_points(scene: Scene, points: Array, bend: float) -> Array:
    """Return flat pad positions (mm) of world points ``(..., 3)``: the inverse of `bend_points`.

    Written without differences of large radii, so that bend 1e-6 loses nothing either.
    """
    kappa = curvature(scene, bend)
    y, w = points[..., 1] - scene.camera.pivot, scene.pad.thickness - points[..., 2]
    radius = np.hypot(kappa * y, 1.0 + kappa * w)
    below = (kappa * (y**2 + w**2) + 2.0 * w) / (radius + 1.0)
    along = np.arctan2(kappa * y, 1.0 + kappa * w) / kappa if kappa else y
    return np.stack(
        [points[..., 0], scene.camera.pivot + along, scene.pad.thickness - below], axis=-1
    )


def distance_to_arc(kappa: float, start: Array, direction: Array) -> Array:
    """Return the way to the arc ``kappa (y^2 + z^2) = 2 z`` from its outside, ``inf`` if missed.

    The nearer root is written so that it stays exact as the arc straightens into ``z = 0``.
    """
    y, z = start[..., 1], start[..., 2]
    dy, dz = direction[..., 1], direction[..., 2]
    a = kappa * (dy**2 + dz**2)
    half_b = kappa * (y * dy + z * dz) - dz
    c = kappa * (y**2 + z**2) - 2.0 * z
    discriminant = half_b**2 - a * c
    met = (discriminant >= 0.0) & (half_b < 0.0)
    denominator = np.sqrt(np.where(met, discriminant, 0.0)) - half_b
    return np.where(met, c / np.where(met, denominator, 1.0), np.inf)
