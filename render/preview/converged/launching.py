"""Photons as they leave a lamp, for all nodes of its direction at once.

As in `render.preview.diffuser.emission`, in compiled code: rays are drawn from the mixture of all
nodes and carry a weight for each (balance heuristic, Veach 1997, ch. 9).
"""

from __future__ import annotations

import math

import numpy as np

from render.arrays import Array
from render.compiled import compiled
from render.geometry import fiber_poses
from render.preview.diffuser.cache import fiber_ends
from render.scene import Scene
from render.spread_points import spread_points

ANGLES = np.linspace(0.0, np.pi / 2, 8193)
"""Angles from the beam (rad) at which radiance is kept; linear between."""
EDGE = 1.0001
"""Squared radius of an end that counts as inside, in spite of rounding."""


def launched(
    scene: Scene, bend: float, lamp: int, phi: Array, photons: range, key: int
) -> tuple[Array, Array, Array]:
    """Return photons of a lamp: origins and directions ``(ray, 3)``, weights ``(ray, node)``.

    In the world, from evenly spread points, of which ``photons`` are the numbers and ``key``
    chooses the shift; weights of a node add up to 1. A lamp that does not turn has one node.
    """
    poses, end = fiber_poses(scene, bend), fiber_ends(scene)[lamp]
    if not poses.turns[lamp]:
        phi = np.array([np.pi / 2])
    drawn = spread_points(photons, 5, key)
    theta, flux = end.flux()
    angle = np.interp(drawn[:, 1], flux, theta)
    origin, direction = np.empty((len(drawn), 3)), np.empty((len(drawn), 3))
    weights = np.empty((len(drawn), len(phi)))
    axes, radius = end.directions(phi), 0.5 * end.diameter
    _launch(drawn, angle, axes, radius, end.radiance(ANGLES), origin, direction, weights)
    frame = np.stack([poses.along[lamp], poses.inward[lamp], poses.up[lamp]])
    return poses.position[lamp] + origin @ frame, direction @ frame, weights


@compiled
def _launch(
    drawn: Array, angle: Array, axes: Array, radius: float, radiance: Array, origin: Array,
    direction: Array, weights: Array,
) -> None:  # fmt: skip
    """Write origins, directions and weights of rays, in the frame of the lamp's ``axes``.

    ``drawn`` ``(ray, 5)`` in [0, 1) chooses node, (angle,) azimuth and place on the end.
    """
    nodes, last = len(axes), len(radiance) - 1
    a, s, t = np.empty(3), np.empty(3), np.empty(3)
    for ray in range(len(drawn)):
        a[:] = axes[min(int(drawn[ray, 0] * nodes), nodes - 1)]
        # Frame of Duff et al. 2017.
        sign = 1.0 if a[2] >= 0.0 else -1.0
        b = -1.0 / (sign + a[2])
        c = a[0] * a[1] * b
        s[0], s[1], s[2] = 1.0 + sign * a[0] * a[0] * b, sign * c, -sign * a[0]
        t[0], t[1], t[2] = c, sign + a[1] * a[1] * b, -a[1]
        turn, around = 2.0 * math.pi * drawn[ray, 2], 2.0 * math.pi * drawn[ray, 4]
        sin, cos = math.sin(angle[ray]), math.cos(angle[ray])
        out = radius * math.sqrt(drawn[ray, 3])
        for k in range(3):
            direction[ray, k] = cos * a[k] + sin * (math.cos(turn) * s[k] + math.sin(turn) * t[k])
            origin[ray, k] = out * (math.cos(around) * s[k] + math.sin(around) * t[k])
        total = 0.0
        for node in range(nodes):
            cosine = along = squared = 0.0
            for k in range(3):
                cosine += direction[ray, k] * axes[node, k]
                along += origin[ray, k] * axes[node, k]
            value = 0.0
            if cosine > 1e-9:
                # Where the ray's line meets the node's end, seen from the end's center.
                for k in range(3):
                    off = origin[ray, k] - direction[ray, k] * along / cosine
                    squared += off * off
                if squared <= EDGE * radius * radius:
                    place = math.acos(min(1.0, cosine)) * (2.0 / math.pi) * last
                    before = min(int(place), last - 1)
                    after = place - before
                    value = (1.0 - after) * radiance[before] + after * radiance[before + 1]
            weights[ray, node] = value
            total += value
        for node in range(nodes):
            weights[ray, node] *= nodes / (total * len(drawn))
