"""The preview's lights: point lights in the pad that stand for what the fibers send into it."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np

from render.arrays import Array
from render.geometry import flat_fiber_poses
from render.preview.beams import BEAM_MARK, NO_TURNS, TURN_MARKS, Beams, shines_past_layers
from render.preview.bonded import Bond
from render.preview.diffuser.cache import fiber_ends, hides_lamps, slab_of, slab_response
from render.preview.diffuser.emission import FiberEnd
from render.preview.diffuser.random_walk import Slab
from render.preview.diffuser.response import RAYS, SlabResponse
from render.preview.glow import Glow
from render.preview.light_paths import near_wall, wall_images
from render.scene import EDGES, Scene

IMAGE_MARK, END_MARK = 4096, -1
"""Parts of a light's mark, see `with_images`."""


@runtime_checkable
class PointLights(Protocol):
    """Point lights in flat pad coordinates, and what they emit for given fiber directions.

    position: ``(fiber, light, 4)``: x, y, z (mm) and a mark: the number of the face, and for a beam
        the marks of `render.preview.beams`.
    edge_albedo: of the pad's edges, seen from inside.
    defines: what the shader is specialized by.
    profiles: ``(row, step)`` measured profiles of beams, or None.
    nodes: ``(node,)`` rad when emission is the polynomial in phi through these nodes, else None.
    units: lists ``(list, light, 4)`` and emissions ``(list * 3, light, n)`` of which emission is a
        linear combination for any design, or None.
    """

    position: Array
    edge_albedo: float
    defines: dict[str, str]
    profiles: Array | None

    @property
    def nodes(self) -> Array | None:
        """Return the nodes of emission in phi."""

    @property
    def units(self) -> tuple[Array, Array] | None:
        """Return lists of lights and their emissions, one unit in each row of emissions."""

    def unit_amounts(self, phi: Array, power: Array) -> Array:
        """Return ``(3, unit)``, of what `merged` returns the part that `units` make."""

    def not_in_units(self, phi: Array, power: Array) -> tuple[Array, Array] | None:
        """Return what `merged` returns beside them, or None."""

    def emission(self, phi: Array) -> Array:
        """Return what unit fibers emit at ``phi`` ``(..., fiber)``: ``(..., fiber, light, n)``."""

    def merged(self, phi: Array, power: Array) -> tuple[Array, Array]:
        """Return the lights of all fibers as one list ``(1, light, 4)`` with ``(3, light, n)``.

        ``phi`` is ``(fiber,)`` rad, ``power`` ``(fiber, 3)``.
        """


def point_lights(scene: Scene, cache: Path | None = None, bond: Bond | None = None) -> PointLights:
    """Return the lights that the scene requires: beams, the diffuser's glow, or both.

    ``bond`` is where a window of another index begins, under which there is no diffuser.
    """
    poses = flat_fiber_poses(scene)
    behind = np.flatnonzero(poses.layer > 0.0)
    if not len(behind):
        return Beams(scene, bond)
    ends = fiber_ends(scene)
    # Rows of equal ends on edges of equal roughness share one response.
    edges = [EDGES[face] for face in poses.face[behind]]
    kinds = [(ends[i], slab_of(scene, edge)) for i, edge in zip(behind, edges, strict=True)]
    made: dict[tuple[FiberEnd, Slab], SlabResponse] = {}
    for kind, edge in zip(kinds, edges, strict=True):
        if kind not in made:
            made[kind] = slab_response(scene, kind[0], edge=edge, cache=cache, rays=RAYS)
    glow = Glow(scene, [made[kind] for kind in kinds], behind)
    opaque = hides_lamps(scene)
    if opaque and not shines_past_layers(scene).any():
        return glow
    return GlowAndBeams(glow, Beams(scene, through_layers=not opaque), behind)


def with_images(scene: Scene, position: Array) -> Array:
    """Return lists of lights ``(list, light, 4)`` followed by their images in clear edges.

    Only glows near enough have images that count (`near_wall`); beams have their own. The mark of
    one is the light's own, the turns of its image as in that of a beam, and `IMAGE_MARK` times the
    light's number from 1. Lists end with the mark -1, padded to the longest.
    """
    glows = (position[..., 3].astype(int) & BEAM_MARK) == 0
    walls = wall_images(scene) if glows.any() else []
    lists: list[list[Array]] = [[] for _ in position]
    for wall in walls:
        near = (wall.distance(position[..., :3]) < near_wall(scene)) & glows
        turned = float(np.dot(np.add(wall.turns, NO_TURNS), TURN_MARKS))
        for row, lights in enumerate(position):
            (index,) = np.nonzero(near[row])
            mark = lights[index, 3:] + turned + IMAGE_MARK * (index[:, None] + 1)
            lists[row].append(np.concatenate([wall.image(lights[index, :3]), mark], axis=1))
    images = np.zeros((len(position), 1 + max(sum(map(len, parts)) for parts in lists), 4))
    images[..., 3] = END_MARK
    for row, parts in enumerate(lists):
        joined = np.concatenate([images[row, :0], *parts])
        images[row, : len(joined)] = joined
    return np.concatenate([position, images], axis=1)


class GlowAndBeams:
    """The glow of a diffuser together with beams that pass it unscattered, or beside it."""

    nodes = None

    def __init__(self, glow: Glow, beams: Beams, behind: np.ndarray) -> None:
        """Join the two lists of lights; ``behind`` are the lamps that make the diffuser glow."""
        self._glow, self._beams, self._behind = glow, beams, behind
        self.profiles = beams.profiles
        # A lamp without a glow has lights without power in its place.
        glowing = np.repeat(glow.position[:1], len(beams.position), axis=0)
        glowing[behind] = glow.position
        self.position = np.concatenate([glowing, beams.position], axis=1)
        self.edge_albedo = glow.edge_albedo
        self.defines = {**beams.defines, **glow.defines}

    def emission(self, phi: Array) -> Array:
        """Return ``(..., fiber, light, n)``, beams padded to the size of glows."""
        beams, glow = self._beams.emission(phi), self._glow.emission(phi)
        all_of = np.zeros((*phi.shape, *glow.shape[-2:]))
        all_of[..., self._behind, :, :] = glow
        return _joined([all_of, beams])

    @property
    def units(self) -> tuple[Array, Array]:
        """Return those of the glow; a beam is not linear in its direction."""
        position, emission = self._glow.units
        texels = 4 * int(self.defines["EMISSION_TEXELS"])
        return position, _joined([emission, np.zeros((len(emission), 0, texels))])

    def unit_amounts(self, phi: Array, power: Array) -> Array:
        """Return those of the glow."""
        return self._glow.unit_amounts(phi, power)

    def not_in_units(self, phi: Array, power: Array) -> tuple[Array, Array]:
        """Return the beams."""
        position, emission = self._beams.merged(phi, power)
        glow = np.zeros((3, 0, 4 * int(self.defines["EMISSION_TEXELS"])))
        return position, _joined([glow, emission])

    def merged(self, phi: Array, power: Array) -> tuple[Array, Array]:
        """Return both lists, one after the other."""
        parts = (self._glow, self._beams)
        positions, emissions = zip(*(part.merged(phi, power) for part in parts), strict=True)
        return np.concatenate(positions, axis=1), _joined(list(emissions))


def _joined(parts: list[Array]) -> Array:
    size = max(part.shape[-1] for part in parts)
    padded = [
        np.pad(part, [(0, 0)] * (part.ndim - 1) + [(0, size - part.shape[-1])]) for part in parts
    ]
    return np.concatenate(padded, axis=-2)
