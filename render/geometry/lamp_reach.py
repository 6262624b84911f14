"""How much of a lamp's light meets the silicone, and how much of its end stands before a face.

Straight rays of the lamp against the flat box that holds the silicone; no face reflects. A lamp
that turns counts in the direction in which most of its light meets the silicone.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import qmc

from render.arrays import Array
from render.scene import OUTWARD, PlacedLamp, Scene

LOG2_RAYS = 11
DIRECTIONS = np.linspace(0.0, np.pi, 13)
"""Of a lamp that turns, rad."""
ANGLES = 4097
"""Steps from the axis to a right angle in which a profile is summed."""


def light_shares(scene: Scene) -> Array:
    """Return ``(lamp,)`` the share of each lamp's light that meets the silicone, 0 to 1.

    By 2048 rays, so known to about 0.002; of a lamp in the silicone it is 1.
    """
    box, rise = scene.box, 0.0 if scene.skin is None else _highest_rise(scene)
    low, high = box.low, box.high + [0.0, 0.0, rise]
    draws = qmc.Sobol(4, seed=0).random_base2(LOG2_RAYS)
    return np.array([_share(lamp, low, high, draws) for lamp in scene.placed_lamps()])


def shares_before_face(scene: Scene) -> Array:
    """Return ``(lamp,)`` the share of each lamp's end that stands before its face, 0 to 1.

    The rest of the end, seen along the face's normal, is beside the face. Lamps in the silicone,
    and those whose center is beside their face, have 1: the first have no face, the others shine
    at it from aside.
    """
    box, found = scene.box, []
    grid = (np.arange(64) + 0.5) / 32 - 1.0
    u, v = (part[np.hypot(*np.meshgrid(grid, grid)) < 1.0] for part in np.meshgrid(grid, grid))
    for lamp in scene.placed_lamps():
        axes = np.delete(np.arange(3), np.abs(OUTWARD[lamp.face]).argmax())
        first, second = _across(lamp.beam)
        ends = lamp.position + lamp.diameter / 2 * (u[:, None] * first + v[:, None] * second)
        beside = ((ends < box.low) | (ends > box.high))[:, axes].any(axis=1)
        before = ((box.low <= lamp.position) & (lamp.position <= box.high))[axes].all()
        found.append(1.0 - beside.mean() if before and lamp.solid is None else 1.0)
    return np.array(found)


def _share(lamp: PlacedLamp, low: Array, high: Array, draws: Array) -> float:
    if lamp.solid is not None:
        return 1.0
    theta = np.linspace(0.0, np.pi / 2, ANGLES)
    mass = np.cumsum(lamp.profile.shape(theta) * np.sin(theta))
    polar = np.interp(draws[:, 0] * mass[-1], mass, theta)
    azimuth, at = 2 * np.pi * draws[:, 1], 2 * np.pi * draws[:, 2]
    radius = lamp.diameter / 2 * np.sqrt(draws[:, 3])
    best = 0.0
    up = np.array([0.0, 0.0, 1.0])
    for phi in DIRECTIONS if lamp.turns else [np.pi / 2]:
        level = np.cos(phi) * lamp.along + np.sin(phi) * lamp.inward
        beam = np.cos(lamp.tilt) * level + np.sin(lamp.tilt) * up
        first, second = _across(beam)
        origin = lamp.position + radius[:, None] * (
            np.cos(at)[:, None] * first + np.sin(at)[:, None] * second
        )
        aside = np.cos(azimuth)[:, None] * first + np.sin(azimuth)[:, None] * second
        ray = np.cos(polar)[:, None] * beam + np.sin(polar)[:, None] * aside
        best = max(best, float(_meets(origin, ray, low, high).mean()))
    return best


def _meets(origin: Array, ray: Array, low: Array, high: Array) -> Array:
    """Return which rays meet the box, by slabs."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ways = np.sort(np.stack([(low - origin) / ray, (high - origin) / ray]), axis=0)
    enter, leave = np.nanmax(ways[0], axis=1), np.nanmin(ways[1], axis=1)
    return np.asarray((enter <= leave) & (leave > 0.0))


def _across(beam: Array) -> tuple[Array, Array]:
    first = np.cross(beam, np.eye(3)[np.abs(beam).argmin()])
    first = first / np.linalg.norm(first)
    return first, np.cross(beam, first)


def _highest_rise(scene: Scene) -> float:
    assert scene.skin is not None
    x, y = (np.linspace(-half, half, 65) for half in (scene.pad.width / 2, scene.pad.length / 2))
    return max(float(np.max(scene.skin.rise(*np.meshgrid(x, y)))), 0.0)
