"""The two ways of light inside the bent pad: straight, and once reflected by the lower face.

Everything is written in flat pad coordinates ``(x, y along the coating's arc, z)`` and in local
frames (across, towards the tip, towards the coating), where bending appears as the curvature alone.
A ray's distance of closest approach to the bend axis does not change when the lower face reflects
it, so light that misses the convex coating once misses it for ever: one reflection is all there is.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np

from render.arrays import Array
from render.geometry import SkinChart, fresnel
from render.scene import EDGES, Scene


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
"""Lights nearer to the one clear edge than this many thicknesses of the pad are seen in it."""
FAR_IMAGES, MOST_IMAGES = 6.0, 3
"""Images of a bare pad that lie nearer than this many thicknesses count, in a row so many."""
MIN_CURVATURE = 1e-9
"""1/mm; a flatter pad is drawn with this curvature, which lifts its ends by 1e-7 mm."""
LEFT, TIP, RIGHT, BASE = range(len(EDGES))

Turns = tuple[int, int]
"""Reflections at edges along x and y, towards +x and +y where positive."""


class WallImage(NamedTuple):
    """The pad as it is seen after reflections at its edges: method of images in a box.

    Light to it goes ``turns`` times through edges of the unfolded pad. ``low`` and ``size``
    ``(2,)`` are those of the pad, mm. Edges go through the bend axis or are at right angles to
    it, so single images are those of the flat pad at any bend.
    """

    turns: Turns
    low: tuple[float, float]
    size: tuple[float, float]

    @property
    def flip(self) -> Array:
        """Signs ``(3,)`` of a mirrored direction."""
        return np.array([*((-1.0) ** abs(turn) for turn in self.turns), 1.0])

    def distance(self, position: Array) -> Array:
        """Return the distance (mm) of flat positions ``(..., 3)`` from the first edges."""
        ways = [
            np.abs(position[..., axis] - (low if turn < 0 else low + size))
            for axis, (turn, low, size) in enumerate(zip(*self, strict=True))
            if turn
        ]
        return np.asarray(np.max(ways, axis=0))

    def image(self, position: Array) -> Array:
        """Return the mirror images of flat positions ``(..., 3)``."""
        center, step = np.zeros(3), np.zeros(3)
        center[:2] = np.add(self.low, np.divide(self.size, 2))
        step[:2] = np.multiply(self.turns, self.size)
        return np.asarray((position - center) * self.flip + center + step)


def walls_met(turns: Turns) -> dict[int, int]:
    """Return how often light of an image meets each edge (number in `FACES`), facing ones in turn.

    >>> walls_met((3, -1)) == {RIGHT: 2, LEFT: 1, BASE: 1}
    True
    """
    met: dict[int, int] = {}
    for turn, (near, far) in zip(turns, ((RIGHT, LEFT), (TIP, BASE)), strict=True):
        first, second = (near, far) if turn > 0 else (far, near)
        met |= {first: (abs(turn) + 1) // 2, second: abs(turn) // 2}
    return {face: count for face, count in met.items() if count}


def reaches(scene: Scene, turns: Turns) -> bool:
    """Return whether light comes back from all edges of an image as from mirrors."""
    met = walls_met(turns)
    paints, layered = [scene.finishes[face].paint for face in met], scene.box.layered
    return not layered[list(met)].any() and all(paint is None or paint.mirror for paint in paints)


def walls_reflect(scene: Scene, turns: Turns, direction: Array) -> Array:
    """Return what is left of light along ``direction`` ``(..., 3)`` after all edges of an image."""
    left = np.ones(direction.shape[:-1])
    for face, count in walls_met(turns).items():
        paint = scene.finishes[face].paint
        left *= (
            face_reflects(scene, np.abs(direction[..., 0 if face in (LEFT, RIGHT) else 1]))
            if paint is None
            else paint.reflectance
        ) ** count
    return left


def meets_edges(scene: Scene, source: Array, target: Array, turns: Turns) -> Array:
    """Return 1 where light from unfolded ``source`` ``(..., 3)`` meets all edges of an image.

    Edges end at the skin, so where it is not flat light may pass above them: 0. ``source`` is the
    image of a point after ``turns``, and below 0 where light comes by way of the lower face.
    """
    met = np.ones(np.broadcast_shapes(source.shape, target.shape)[:-1])
    if scene.skin is None or turns == (0, 0):
        return met
    low, size, way = scene.box.low, scene.box.high - scene.box.low, source - target
    chart, half = SkinChart(scene, 0.0), np.array([scene.pad.width, scene.pad.length]) / 2
    for axis, turn in enumerate(turns):
        for count in range(abs(turn)):
            plane = low[axis] + (size[axis] * (count + 1) if turn > 0 else -size[axis] * count)
            with np.errstate(divide="ignore", invalid="ignore"):
                part = (plane - target[..., axis]) / way[..., axis]
            place = target + np.where(np.isfinite(part), part, 0.0)[..., None] * way
            # Back into the pad: the unfolded one repeats every two lengths.
            turned = (place[..., :2] - low[:2]) % (2 * size[:2])
            folded = low[:2] + np.minimum(turned, 2 * size[:2] - turned)
            met *= np.abs(place[..., 2]) < chart.height(np.clip(folded, -half, half))
    return met


def face_reflects(scene: Scene, cosine: Array) -> Array:
    """Return the reflectance of a smooth face between silicone and air from inside."""
    return np.asarray(fresnel(cosine, 1 / scene.pad.index)[0])


def wall_image(scene: Scene, turns: Turns) -> WallImage:
    """Return the image of the silicone after ``turns`` reflections along x and y."""
    low, size = scene.box.low, scene.box.high - scene.box.low
    return WallImage(turns, (low[0], low[1]), (size[0], size[1]))


def single_turns(scene: Scene) -> list[Turns] | None:
    """Return the images in single edges; None: a pad that has images of images as well.

    White and black edges have none, and those with a diffuser: where it lies on three, the fourth
    alone reflects. A pad that never bends is the box that images of images are exact in; one that
    bends has those of each edge.
    """
    if not _rimmed(scene) and not any(scene.bending.angles):
        return None
    return [turns for turns in ((0, -1), (-1, 0), (0, 1), (1, 0)) if reaches(scene, turns)]


def _rimmed(scene: Scene) -> bool:
    """Return whether a diffuser lies around the pad, on all edges or all but one."""
    return len(scene.diffuser_edges) >= len(EDGES) - 1


def wall_images(scene: Scene) -> list[WallImage]:
    """Return the images that diffuse light in the pad is seen in, as far as it reaches."""
    single = single_turns(scene)
    if single is not None:
        return [wall_image(scene, turns) for turns in single]
    far = FAR_IMAGES * scene.pad.thickness
    across, along = (
        min(MOST_IMAGES, 1 + int(far / size)) for size in (scene.pad.width, scene.pad.length)
    )
    grid = itertools.product(range(-across, across + 1), range(-along, along + 1))
    return [wall_image(scene, turns) for turns in grid if turns != (0, 0) and reaches(scene, turns)]


def near_wall(scene: Scene) -> float:
    """Return the distance (mm) from a wall below which a light's image in it counts.

    A diffuser around the pad sends back more than its far walls, unless they are metal.
    """
    metal = any(scene.finish(edge).metal is not None for edge in EDGES)
    return WALL_DISTANCE * scene.pad.thickness if _rimmed(scene) and not metal else np.inf


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
    visible = (nearer | (dip * along > to_source[..., 2])) & (np.abs(phi) < np.pi)
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
    Newton's iteration from the flat mirror's solution solves it, which is the flat pad's own. The
    spread follows from Coddington's equation for the arc's plane.
    """
    kappa = max(kappa, MIN_CURVATURE)
    k = kappa / (1 + kappa * thickness)
    across, along, _ = np.moveaxis(target - source, -1, 0)
    heading, arc = np.sign(along), kappa * np.abs(along)
    z_source, z_target = np.broadcast_arrays(source[..., 2], target[..., 2])
    a, c = k * z_source, k * z_target
    p, q = 1 - a, 1 - c
    theta = arc * a / (a + c)
    for _ in range(4 if kappa > MIN_CURVATURE else 0):
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
    visible = (arc < np.pi) & (drop_source > 0) & (drop_target + dip * np.abs(arrive[..., 1]) > 0)
    return LightPath(
        depart / np.linalg.norm(depart, axis=-1, keepdims=True),
        arrive / np.linalg.norm(arrive, axis=-1, keepdims=True),
        visible * total / (length**2 * width),
        n1 / l1 * total / length,
    )


def _horizon_dip(below: Array) -> Array:
    """Return the tangent of the horizon's dip at a depth ``below`` in units of the arc's radius."""
    return np.asarray(np.sqrt(np.maximum(below * (2 + below), 0.0)))
