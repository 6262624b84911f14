"""The preview's lights: point lights in the pad that stand for what the fibers send into it."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import numpy as np

from render.arrays import Array
from render.preview.beams import Beams
from render.preview.diffuser.cache import slab_of, slab_response
from render.preview.diffuser.response import OPAQUE_THICKNESS, RAYS
from render.preview.glow import Glow
from render.preview.light_paths import near_base
from render.scene import Scene

IMAGE_MARK, END_MARK = 8, -1
"""Parts of a light's mark, see `with_images`."""


class PointLights(Protocol):
    """Point lights in flat pad coordinates, and what they emit for given fiber directions.

    position: ``(fiber, light, 4)``: x, y, z (mm) and the number of the edge (+ 4 for a beam).
    edge_albedo: of the pad's edges, seen from inside.
    defines: what the shader is specialized by.
    nodes: ``(node,)`` rad when emission is the polynomial in phi through these nodes, else None.
    """

    position: Array
    edge_albedo: float
    defines: dict[str, str]

    @property
    def nodes(self) -> Array | None:
        """Return the nodes of emission in phi."""

    def emission(self, phi: Array) -> Array:
        """Return what unit fibers emit at ``phi`` ``(..., fiber)``: ``(..., fiber, light, n)``."""

    def merged(self, phi: Array, power: Array) -> tuple[Array, Array]:
        """Return the lights of all fibers as one list ``(1, light, 4)`` with ``(3, light, n)``.

        ``phi`` is ``(fiber,)`` rad, ``power`` ``(fiber, 3)``.
        """


def point_lights(scene: Scene, cache: Path | None = None) -> PointLights:
    """Return the lights that the scene requires: beams, the diffuser's glow, or both."""
    if scene.diffuser is None:
        return Beams(scene)
    glow = Glow(scene, slab_response(scene, cache=cache, rays=RAYS))
    if slab_of(scene).optical_thickness >= OPAQUE_THICKNESS:
        return glow
    return GlowAndBeams(glow, Beams(scene))


def with_images(scene: Scene, position: Array) -> Array:
    """Return lists of lights ``(list, light, 4)`` followed by their images in the pad's base.

    Only lights near the base have an image that counts. Its mark is the light's own plus 8 times
    the light's number from 1. Lists end with the mark -1, padded to the longest.
    """
    near = position[..., 1] < near_base(scene)
    longest = int(near.sum(axis=1).max())
    images = np.zeros((len(position), longest + 1, 4))
    images[..., 3] = END_MARK
    for row, lights in enumerate(position):
        (index,) = np.nonzero(near[row])
        image = lights[index] * [1, -1, 1, 1] - [0, scene.pad.length, 0, 0]
        image[:, 3] += IMAGE_MARK * (index + 1)
        images[row, : len(index)] = image
    return np.concatenate([position, images], axis=1)


class GlowAndBeams:
    """The glow of a thin diffuser together with the beams that pass it unscattered."""

    nodes = None

    def __init__(self, glow: Glow, beams: Beams) -> None:
        """Join the two lists of lights."""
        self._parts = (glow, beams)
        self.position = np.concatenate([glow.position, beams.position], axis=1)
        self.edge_albedo = glow.edge_albedo
        self.defines = {**beams.defines, **glow.defines}

    def emission(self, phi: Array) -> Array:
        """Return ``(..., fiber, light, n)``, beams padded to the size of glows."""
        return _joined([part.emission(phi) for part in self._parts])

    def merged(self, phi: Array, power: Array) -> tuple[Array, Array]:
        """Return both lists, one after the other."""
        positions, emissions = zip(*(part.merged(phi, power) for part in self._parts), strict=True)
        return np.concatenate(positions, axis=1), _joined(list(emissions))


def _joined(parts: list[Array]) -> Array:
    size = max(part.shape[-1] for part in parts)
    padded = [
        np.pad(part, [(0, 0)] * (part.ndim - 1) + [(0, size - part.shape[-1])]) for part in parts
    ]
    return np.concatenate(padded, axis=-2)
