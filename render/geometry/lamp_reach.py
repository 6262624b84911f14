"""How much of a lamp's light meets the silicone, and how much of its end stands before a face.

Straight rays of the lamp against the flat box that holds the silicone; no face reflects. A lamp
that turns counts in the direction in which most of its light meets the silicone.
"""

from __future__ import annotations

import numpy as np

from render.arrays import Array
from render.geometry.lamp_poses import flat_fiber_poses
from render.scene import OUTWARD, Profile, Scene
from render.scene.lamps import axes_across
from render.spread_points import spread_points

RAYS = 2048
DIRECTIONS = np.linspace(0.0, np.pi, 13)
"""Of a lamp that turns, rad."""
ANGLES = 4097
"""Steps from the axis to a right angle in which a profile is summed."""


def light_shares(scene: Scene) -> Array:
    """Return ``(lamp,)`` the share of each lamp's light that meets the silicone, 0 to 1.

    By `RAYS` rays, so known to about 0.01; of a lamp in the silicone it is 1.
    """
    poses, lamps, box = flat_fiber_poses(scene), scene.placed_lamps(), scene.box
    beams = poses.directions(np.repeat(DIRECTIONS[:, None], len(lamps), axis=1))
    drawn = spread_points(range(RAYS), 4, key=0)
    place = np.sqrt(drawn[:, :1]) * _on_circle(drawn[:, 1])
    found = poses.inside.astype(np.float64)
    for number in np.flatnonzero(~poses.inside):
        theta = _angles(lamps[number].profile, drawn[:, 2])[:, None]
        for beam in np.unique(beams[:, number], axis=0):
            across = axes_across(beam)
            origin = poses.position[number] + poses.radius[number] * place @ across
            ray = np.cos(theta) * beam + np.sin(theta) * (_on_circle(drawn[:, 3]) @ across)
            met = _meets(origin, ray, box.low, box.high).mean()
            found[number] = max(found[number], met)
    return found


def shares_before_face(scene: Scene) -> Array:
    """Return ``(lamp,)`` the share of each lamp's end that stands before its face, 0 to 1.

    The rest of the end, seen along the face's normal, is beside the face. Lamps in the silicone,
    and those whose center is beside their face, have 1: the first have no face, the others shine
    at it from aside.
    """
    box, found = scene.box, []
    grid = np.stack(np.meshgrid(*2 * [(np.arange(64) + 0.5) / 32 - 1.0]), axis=-1)
    disk = grid[np.linalg.norm(grid, axis=-1) < 1.0]
    for lamp in scene.placed_lamps():
        axes = np.delete(np.arange(3), np.abs(OUTWARD[lamp.face]).argmax())
        end = lamp.position + lamp.diameter / 2 * disk @ axes_across(lamp.beam)
        beside = ((end < box.low) | (end > box.high))[:, axes].any(axis=1)
        before = ((box.low <= lamp.position) & (lamp.position <= box.high))[axes].all()
        found.append(1.0 - beside.mean() if before and lamp.solid is None else 1.0)
    return np.array(found)


def _on_circle(drawn: Array) -> Array:
    """Return points ``(n, 2)`` of the unit circle."""
    return np.stack([np.cos(2 * np.pi * drawn), np.sin(2 * np.pi * drawn)], axis=-1)


def _angles(profile: Profile, drawn: Array) -> Array:
    """Return angles from the axis (rad), drawn in proportion to the light."""
    theta = np.linspace(0.0, np.pi / 2, ANGLES)
    light = np.cumsum(profile.shape(theta) * np.sin(theta))
    return np.asarray(np.interp(drawn * light[-1], light, theta))


def _meets(origin: Array, ray: Array, low: Array, high: Array) -> Array:
    """Return which rays meet the box, by slabs."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ways = np.sort(np.stack([(low - origin) / ray, (high - origin) / ray]), axis=0)
    enter, leave = np.nanmax(ways[0], axis=1), np.nanmin(ways[1], axis=1)
    return np.asarray((enter <= leave) & (leave > 0.0))
