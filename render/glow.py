"""The preview's lights: the diffuser's glow, or bare fiber ends, as point lights in the pad."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import numpy as np

from render.bending import Array
from render.layout import fiber_edges, flat_fiber_poses
from render.scene import EDGES, Scene
from render.rough_face import fresnel
from render.slab import HEIGHTS, MIRROR_ALONG, TERMS, SlabResponse, linear_weights, slab_response
from render.slab_launch import Beam

TEXELS = 3
"""RGBA texels that hold the 9 terms of one glow."""
MERGED_STEP = 1.5
"""Longest step (mm) between the point lights of a whole edge."""


class Lights(Protocol):
    """Point lights in flat pad coordinates, and what they emit for given fiber directions.

    position: ``(fiber, light, 4)``: x, y, z (mm) and the edge's number.
    edge_albedo: of the pad's edges, seen from inside.
    nodes: ``(node,)`` rad when emission is the polynomial in phi through these nodes, else None.
    defines: what the shader is specialised by.
    """

    position: Array
    nodes: Array | None
    edge_albedo: float
    defines: dict[str, str]

    def emission(self, phi: Array) -> Array:
        """Return what unit fibers emit at ``phi`` ``(..., fiber)``: ``(..., fiber, light, 4 n)``."""

    def merged(self, phi: Array, power: Array) -> tuple[Array, Array]:
        """Return all fibers' lights in one list ``(1, light, 4)`` and emission ``(3, light, 4 n)``.

        ``phi`` is ``(fiber,)`` rad, ``power`` ``(fiber, 3)``.
        """


def make_lights(scene: Scene, cache: Path | None = None) -> Lights:
    """Return the lights that the scene requires."""
    return Glow(scene, slab_response(scene, cache=cache)) if scene.diffuser else BareFibers(scene)


class Glow:
    """The glow of the diffuser's inner face: the slab response of every fiber, at its place."""

    def __init__(self, scene: Scene, response: SlabResponse) -> None:
        """Place the response at every fiber."""
        self._scene, self._response = scene, response
        self.edge_albedo = response.albedo
        self.nodes: Array | None = response.phi
        cell = np.median(np.diff(response.offsets)) * scene.pad.thickness / HEIGHTS
        self.defines = {
            "EMISSION_TEXELS": str(TEXELS),
            "SOFT_RADIUS": f"{np.sqrt(cell / np.pi):.6f}",
        }
        edge = np.array([EDGES.index(name) for name in fiber_edges(scene)])
        place = flat_fiber_poses(scene).position
        centre = np.where(edge == EDGES.index("tip"), place[:, 0], place[:, 1])
        reach = np.array([_reach(scene, number) for number in range(len(EDGES))])[edge]
        self._keep, self._fold = _ends(response.offsets, centre, reach, _end_reflectance(scene))
        self._along = np.clip(centre[:, None] + response.offsets, -reach[:, None], reach[:, None])
        self._edge = edge
        self.position = _on_edges(scene, self._along, edge, response.heights)

    def emission(self, phi: Array) -> Array:
        """Return ``(..., fiber, light, 12)``."""
        return _packed(self._radiance(phi).reshape(*phi.shape, -1, TERMS))

    def _radiance(self, phi: Array) -> Array:
        """Return ``(..., fiber, offset, height, term)``; layers end with the edges."""
        endless = self._response.at(phi)
        kept = endless * self._keep[..., None, None]
        return kept + np.einsum("fpo,...fozt->...fpzt", self._fold, endless * MIRROR_ALONG)

    def merged(self, phi: Array, power: Array) -> tuple[Array, Array]:
        """Return the glow of whole edges, shared linearly between evenly spaced lights."""
        radiance = self._radiance(phi)
        positions, emissions = [], []
        for number in range(len(EDGES)):
            reach = _reach(self._scene, number)
            count = int(np.ceil(2 * reach / MERGED_STEP)) + 1
            grid = np.linspace(-reach, reach, count)
            share = _shares(self._along[self._edge == number].ravel(), grid)
            light = np.einsum(
                "fozt,fc->cfozt", radiance[self._edge == number], power[self._edge == number]
            )
            light = light.reshape(3, -1, *light.shape[3:])
            emissions.append(np.einsum("nm,cnzt->cmzt", share, light).reshape(3, -1, TERMS))
            edge = np.array([number])
            positions.append(_on_edges(self._scene, grid[None], edge, self._response.heights))
        return np.concatenate(positions, axis=1), _packed(np.concatenate(emissions, axis=1))


class BareFibers:
    """Fiber ends before a clear pad: seven points of each end face, seen through the pad's edge."""

    edge_albedo = 0.0
    nodes = None

    def __init__(self, scene: Scene) -> None:
        """Place the images of the fiber ends behind the edge."""
        fibers = scene.fibers
        self._scene = scene
        self._beam = Beam(fibers.diameter, fibers.gap, fibers.height, fibers.sigma_v, fibers.tilt)
        self.defines = {
            "BEAM": "1",
            "EMISSION_TEXELS": "1",
            "SOFT_RADIUS": f"{fibers.diameter / 2:.6f}",
        }
        poses = flat_fiber_poses(scene)
        # Rabinowitz and Richter's rule of degree 5 on the disk: its centre and a hexagon.
        azimuth = np.pi / 3 * np.arange(6)
        ring = np.sqrt(2 / 3) * fibers.diameter / 2
        along = np.concatenate([[0.0], ring * np.cos(azimuth)])
        up = np.concatenate([[0.0], ring * np.sin(azimuth)])
        self._weight = np.array([0.25] + [0.125] * 6)
        # Seen from inside the pad the air gap looks longer by the index (paraxial image).
        image = poses.position - fibers.gap * (scene.pad.index - 1) * poses.inward
        place = image[:, None] + along[:, None] * poses.along[:, None]
        place[..., 2] += up
        margin = 1e-3 * scene.pad.thickness
        place[..., 2] = np.clip(place[..., 2], margin, scene.pad.thickness - margin)
        edge = np.array([EDGES.index(name) for name in fiber_edges(scene)], dtype=np.float64)
        number = np.broadcast_to(edge[:, None, None], (*place.shape[:2], 1))
        self.position = np.concatenate([place, number], axis=-1)

    def emission(self, phi: Array) -> Array:
        """Return beam direction in the edge's frame and peak intensity, ``(..., fiber, 7, 4)``."""
        beam = self._beam.directions(phi)
        shape = (*phi.shape, len(self._weight))
        peak = np.broadcast_to(self._weight * self._beam.peak_intensity, shape)
        beams = np.broadcast_to(beam[..., None, :], (*shape, 3))
        return np.concatenate([beams, peak[..., None]], axis=-1)

    def merged(self, phi: Array, power: Array) -> tuple[Array, Array]:
        """Return all end points of all fibers."""
        emission = np.broadcast_to(self.emission(phi), (3, *self.position.shape)).copy()
        emission[..., 3] *= power.T[..., None]
        return self.position.reshape(1, -1, 4), emission.reshape(3, -1, 4)


def _ends(offsets: Array, centre: Array, reach: Array, reflectance: float) -> tuple[Array, Array]:
    """Return what the ends of the layer make of an endless layer's lights.

    Each light stands for the cell between its neighbours. The part of a cell inside the edge is
    kept, ``(fiber, offset)``; of the part beyond an end, ``reflectance`` comes back mirrored, shared
    between the two lights nearest to its image, ``(fiber, to offset, from offset)``.
    """
    middle = 0.5 * (offsets[1:] + offsets[:-1])
    low = centre[:, None] + np.concatenate([2 * offsets[:1] - middle[:1], middle])
    high = centre[:, None] + np.concatenate([middle, 2 * offsets[-1:] - middle[-1:]])
    bound = reach[:, None]
    keep = np.clip(np.minimum(high, bound) - np.maximum(low, -bound), 0.0, None) / (high - low)
    fold = np.zeros((len(centre), len(offsets), len(offsets)))
    for fiber, (place, end) in enumerate(zip(centre, reach, strict=True)):
        for light in range(len(offsets)):
            for sign, first, last in (
                (-1, low[fiber, light], min(high[fiber, light], -end)),
                (1, max(low[fiber, light], end), high[fiber, light]),
            ):
                if last > first:
                    image = max(2 * end - sign * 0.5 * (first + last), -end) * sign - place
                    share = linear_weights(np.array([image]), offsets)[0]
                    beyond = (last - first) / (high[fiber, light] - low[fiber, light])
                    fold[fiber, :, light] += reflectance * beyond * share
    return keep, fold


def _end_reflectance(scene: Scene) -> float:
    """Return the reflectance of a dielectric face for diffuse light from inside."""
    cosine = np.linspace(0.0, 1.0, 2001)
    reflected = fresnel(cosine, 1 / scene.pad.index)[0]
    return float(np.trapezoid(2 * cosine * reflected, cosine))


def _reach(scene: Scene, edge: int) -> float:
    """Return half the length (mm) of an edge's inner face."""
    return (scene.pad.width if EDGES[edge] == "tip" else scene.pad.length) / 2


def _on_edges(scene: Scene, along: Array, edge: Array, heights: Array) -> Array:
    """Return positions ``(list, light, 4)`` at ``along`` ``(list, offset)`` on inner faces."""
    shape = (*along.shape, len(heights))
    spread = np.broadcast_to(along[..., None], shape)
    number = np.broadcast_to(edge[:, None, None], shape)
    side = np.where(number == EDGES.index("left"), -1.0, 1.0) * scene.pad.width / 2
    tip = number == EDGES.index("tip")
    x = np.where(tip, spread, side)
    y = np.where(tip, scene.pad.length / 2, spread)
    z = np.broadcast_to(heights, shape)
    return np.stack([x, y, z, number.astype(np.float64)], axis=-1).reshape(len(along), -1, 4)


def _shares(place: Array, grid: Array) -> Array:
    """Return ``(light, grid point)`` weights that share lights between the nearest two points."""
    step = grid[1] - grid[0]
    return np.asarray(np.maximum(1 - np.abs(place[:, None] - grid) / step, 0.0))


def _packed(radiance: Array) -> Array:
    padding = np.zeros((*radiance.shape[:-1], 4 * TEXELS - TERMS))
    return np.concatenate([radiance, padding], axis=-1)
