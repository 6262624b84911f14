"""The two ways of light inside the bent pad: straight, and once reflected by the lower face.

Everything is written in flat pad coordinates ``(x, y along the coating's arc, z)`` and in local
frames (across, towards the tip, towards the coating), where bending appears as the curvature alone.
A ray's distance of closest approach to the bend axis does not change when the lower face reflects
it, so light that misses the convex coating once misses it for ever: one reflection is all there is.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from render.arrays import Array
from render.scene import Scene


class LightPath(NamedTuple):
    """Ways of light from sources to targets, all arrays broadcast ``(...)``.

    depart: unit directions ``(..., 3)`` at the sources, in their local frames.
    arrive: unit directions ``(..., 3)`` at the targets, back along the way, in their local frames.
    spread: irradiance across the way per intensity at the source (1/mm^2), 0 when hidden.
    cosine: cosine of incidence at the lower face (1 for straight ways).
    """

    depart: Array
    arrive: Array
    spread: Array
    cosine: Array


WALL_DISTANCE = 2.0
"""Lights nearer to the base than this many thicknesses of the pad are seen in it as well."""
MIN_CURVATURE = 1e-9
"""1/mm; a flatter pad is drawn with this curvature, which lifts its ends by 1e-7 mm."""


class Wall(NamedTuple):
    """A clear edge of the pad: a plane that reflects what grazes it.

    Normal to ``axis`` (0: x, 1: y) at ``place`` (mm) in flat coordinates. It goes through the bend
    axis or is at right angles to it, so images are those of the flat pad at any bend.
    """

    axis: int
    place: float

    @property
    def flip(self) -> Array:
        """Signs ``(3,)`` of a mirrored direction."""
        return np.where(np.arange(3) == self.axis, -1.0, 1.0)

    def distance(self, position: Array) -> Array:
        """Return the distance (mm) of flat positions ``(..., 3)``."""
        return np.asarray(np.abs(position[..., self.axis] - self.place))

    def image(self, position: Array) -> Array:
        """Return the mirror images of flat positions ``(..., 3)``."""
        shift = np.where(np.arange(3) == self.axis, 2 * self.place, 0.0)
        return np.asarray(position * self.flip + shift)


def clear_walls(scene: Scene) -> list[Wall]:
    """Return the edges without a diffuser: the base, or all of them."""
    half_width, half_length = scene.pad.width / 2, scene.pad.length / 2
    walls = [Wall(1, -half_length)]
    if scene.diffuser is None:
        walls += [Wall(0, -half_width), Wall(1, half_length), Wall(0, half_width)]
    return walls


def near_wall(scene: Scene) -> float:
    """Return the distance (mm) from a wall below which a light's image in it counts.

    A diffuser around the pad sends back more than its far walls.
    """
    return WALL_DISTANCE * scene.pad.thickness if scene.diffuser else np.inf


def direct_path(source: Array, target: Array, thickness: float, kappa: float) -> LightPath:
    """Return the straight ways between flat positions ``(..., 3)`` (mm), hidden by the horizon."""
    kappa = max(kappa, MIN_CURVATURE)
    across, around, rise = np.moveaxis(target - source, -1, 0)
    phi = kappa * around
    sine, sag = np.sin(phi) / kappa, 2 * np.sin(phi / 2) ** 2 / kappa
    below_source = 1 + kappa * (thickness - source[..., 2])
    below_target = 1 + kappa * (thickness - target[..., 2])
    to_target = np.stack([across, below_target * sine, rise + sag * below_target], axis=-1)
    to_source = np.stack([-across, -below_source * sine, sag * below_source - rise], axis=-1)
    distance = np.linalg.norm(to_target, axis=-1)
    dip = _horizon_dip(kappa * (thickness - target[..., 2]))
    # The coating hides what lies beyond its horizon and above the line that touches it there.
    along = np.abs(to_source[..., 1])
    nearer = (along <= dip / kappa) & (np.cos(phi) > 0)
    visible = nearer | (dip * along > to_source[..., 2])
    inverse_distance = 1 / np.maximum(distance, 1e-9)
    return LightPath(
        to_target * inverse_distance[..., None],
        to_source * inverse_distance[..., None],
        visible * inverse_distance**2,
        np.ones_like(inverse_distance),
    )


def mirrored_path(source: Array, target: Array, thickness: float, kappa: float) -> LightPath:
    """Return the ways by one reflection at the lower face, without its Fresnel factor.

    With arcs ``theta`` and ``psi`` from source and target to the point of reflection and heights
    ``a`` and ``c`` (in units of the lower face's radius), equal angles with the face mean
    ``(1 - a) sin(theta) (1 - (1 - c) cos(psi)) = (1 - c) sin(psi) (1 - (1 - a) cos(theta))``;
    Newton's iteration from the flat mirror's solution solves it. The spread follows from
    Coddington's equation for the arc's plane.
    """
    kappa = max(kappa, MIN_CURVATURE)
    k = kappa / (1 + kappa * thickness)
    across, along, _ = np.moveaxis(target - source, -1, 0)
    heading, arc = np.sign(along), kappa * np.abs(along)
    z_source, z_target = np.broadcast_arrays(source[..., 2], target[..., 2])
    a, c = k * z_source, k * z_target
    p, q = 1 - a, 1 - c
    theta = arc * a / (a + c)
    for _ in range(4):
        psi = arc - theta
        n1, n2 = a + 2 * p * np.sin(theta / 2) ** 2, c + 2 * q * np.sin(psi / 2) ** 2
        f = p * np.sin(theta) * n2 - q * np.sin(psi) * n1
        slope = p * np.cos(theta) * n2 + q * np.cos(psi) * n1
        slope -= 2 * p * q * np.sin(theta) * np.sin(psi)
        theta = np.clip(theta - f / np.maximum(slope, 1e-3 * (a + c)), 0.0, arc)
    psi = arc - theta
    n1, n2 = (a + 2 * p * np.sin(theta / 2) ** 2) / k, (c + 2 * q * np.sin(psi / 2) ** 2) / k
    l1, l2 = np.hypot(p * np.sin(theta) / k, n1), np.hypot(q * np.sin(psi) / k, n2)
    total = l1 + l2
    length = np.hypot(total, across)
    drop_source = z_source - 2 * np.sin(theta / 2) ** 2 / k
    drop_target = z_target - 2 * np.sin(psi / 2) ** 2 / k
    depart = np.stack([across * l1 / total, heading * np.sin(theta) / k, -drop_source], axis=-1)
    arrive = np.stack([-across * l2 / total, -heading * np.sin(psi) / k, -drop_target], axis=-1)
    width = np.maximum(total - 2 * k * l1 * l2 * l1 / n1, 0.1 * total)
    dip = _horizon_dip(kappa * (thickness - z_target))
    visible = (drop_source > 0) & (drop_target + dip * np.abs(arrive[..., 1]) > 0)
    return LightPath(
        depart / np.linalg.norm(depart, axis=-1, keepdims=True),
        arrive / np.linalg.norm(arrive, axis=-1, keepdims=True),
        visible * total / (length**2 * width),
        n1 / l1 * total / length,
    )


def _horizon_dip(below: Array) -> Array:
    """Return the tangent of the horizon's dip at a depth ``below`` in units of the arc's radius."""
    return np.asarray(np.sqrt(np.maximum(below * (2 + below), 0.0)))
