"""The glow of the diffuser as point lights: the slab response of every fiber, at its place."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property

import numpy as np

from render.arrays import Array
from render.geometry import FiberPoses, flat_fiber_poses, fresnel
from render.preview.diffuser.basis import MIRROR_ALONG, TERMS, linear_weights
from render.preview.diffuser.response import SlabResponse
from render.scene import EDGES, Edge, Scene

BESIDE: dict[Edge, tuple[Edge, Edge]] = {
    "left": ("base", "tip"),
    "tip": ("left", "right"),
    "right": ("base", "tip"),
    "base": ("left", "right"),
}
"""The edges where one ends, in the direction of its glows."""
ACROSS = (EDGES.index("tip"), EDGES.index("base"))
"""Numbers of the edges along x."""
TEXELS = 3
"""RGBA texels that hold the 9 terms of one glow."""
MAX_MERGED_STEP, MIN_MERGED_FRACTION = 0.375, 1 / 40
"""Step between the lights of a whole edge: at most so many thicknesses of the pad, unless that is
less than this part of the edge."""
SOFTNESS = 0.7
"""Distance within which a light levels off, in units of the step to the next."""


class Glow:
    """The glow of the diffuser's inner face: the slab response of every fiber, at its place."""

    profiles: Array | None = None

    def __init__(self, scene: Scene, responses: list[SlabResponse], lamps: np.ndarray) -> None:
        """Place the responses of ``lamps`` ``(lamp,)``, numbers of those before the diffuser."""
        self._scene, self._responses, self._lamps = scene, responses, lamps
        self.edge_albedo = responses[0].albedo
        self.nodes = responses[0].phi
        self._poses = poses = flat_fiber_poses(scene)
        offsets = np.array([response.offsets for response in responses])
        step = max(
            float(np.median(np.diff(offsets, axis=1), axis=1).min()),
            MAX_MERGED_STEP * scene.pad.thickness,
        )
        self.defines = {
            "GLOW": "1",
            "EMISSION_TEXELS": str(TEXELS),
            "SOFT_RADIUS": f"{SOFTNESS * step:.6f}",
        }
        edge, place = poses.face[lamps], poses.position[lamps]
        center = np.where(np.isin(edge, ACROSS), place[:, 0], place[:, 1])
        half_length = np.array([_half_length(scene, number) for number in range(len(EDGES))])[edge]
        returned = np.array([[_returned(scene, end) for end in BESIDE[one]] for one in EDGES])[edge]
        self._inside, self._folded = _ends(offsets, center, half_length, returned)
        ends = half_length[:, None]
        self._along = np.clip(center[:, None] + offsets, -ends, ends)
        self._edge = edge
        self.position = _on_edges(scene, self._along, edge, responses[0].heights)

    def emission(self, phi: Array) -> Array:
        """Return ``(..., lamp, light, 12)`` for ``phi`` ``(..., fiber)``."""
        radiance = self._radiance(phi)
        return _packed(radiance.reshape(*radiance.shape[:-3], -1, TERMS))

    def _radiance(self, phi: Array) -> Array:
        """Return ``(..., lamp, offset, height, term)``; layers end with the edges."""
        azimuth = azimuths(self._poses, phi)[..., self._lamps]
        endless = np.stack(
            [part.at(azimuth[..., i]) for i, part in enumerate(self._responses)], axis=-4
        )
        inside = endless * self._inside[..., None, None]
        folded = np.einsum("fpo,...fozt->...fpzt", self._folded, endless * MIRROR_ALONG)
        return np.asarray(inside + folded)

    def merged(self, phi: Array, power: Array) -> tuple[Array, Array]:
        """Return the glow of whole edges, shared linearly between evenly spaced lights."""
        radiance, power = self._radiance(phi), power[self._lamps]
        emissions = []
        for number, grid in self._grids():
            weights = _hat_weights(self._along[self._edge == number].ravel(), grid)
            light = np.einsum(
                "fozt,fc->cfozt", radiance[self._edge == number], power[self._edge == number]
            )
            light = light.reshape(3, -1, *light.shape[3:])
            emissions.append(np.einsum("nm,cnzt->cmzt", weights, light).reshape(3, -1, TERMS))
        return self._merged_position, _packed(np.concatenate(emissions, axis=1))

    @property
    def units(self) -> tuple[Array, Array]:
        """Return each light of `merged` three times, each term of its glow in one row."""
        each = TERMS // 3
        position = np.repeat(self._merged_position[0, :, None], each, axis=0)
        terms = np.tile(np.eye(TERMS), (self._merged_position.shape[1], 1))
        return position, _packed(terms[:, None])

    def unit_amounts(self, phi: Array, power: Array) -> Array:
        """Return the glow's terms at each light."""
        return self.merged(phi, power)[1][..., :TERMS].reshape(3, -1)

    def not_in_units(self, phi: Array, power: Array) -> None:
        """Return None: units are everything."""

    @cached_property
    def _merged_position(self) -> Array:
        """Return the positions of `merged`, ``(1, light, 4)``."""
        heights = self._responses[0].heights
        parts = [
            _on_edges(self._scene, grid[None], np.array([number]), heights)
            for number, grid in self._grids()
        ]
        return np.concatenate(parts, axis=1)

    def _grids(self) -> Iterator[tuple[int, Array]]:
        """Yield the edges that glow, by number, and where along them the lights of `merged` are."""
        for number in map(EDGES.index, self._scene.diffuser_edges):
            half_length = _half_length(self._scene, number)
            step = max(
                MAX_MERGED_STEP * self._scene.pad.thickness, MIN_MERGED_FRACTION * 2 * half_length
            )
            count = int(np.ceil(2 * half_length / step)) + 1
            yield number, np.linspace(-half_length, half_length, count)


def azimuths(poses: FiberPoses, phi: Array) -> Array:
    """Return in which direction lamps at ``phi`` ``(..., fiber)`` shine in their faces' frames.

    Radians in [0, pi], 0 along the face and pi/2 straight in.
    """
    upright = np.abs((poses.along * poses.face_along).sum(axis=1) - 1.0) < 1e-12
    beam = poses.directions(phi)
    along = np.einsum("fx,...fx->...f", poses.face_along, beam)
    inward = np.einsum("fx,...fx->...f", poses.face_inward, beam)
    return np.where(upright & poses.turns, phi, np.arctan2(np.maximum(inward, 0.0), along))


def _ends(
    offsets: Array, center: Array, half_length: Array, returned: Array
) -> tuple[Array, Array]:
    """Return what the ends of the layer make of an endless layer's lights.

    ``offsets`` are ``(fiber, offset)``. Each light stands for the cell between its neighbors. The
    part of a cell inside the edge is kept, ``(fiber, offset)``; of what lies beyond an end, the
    part ``returned`` ``(fiber, end)`` comes back mirrored, shared between the two lights nearest to
    its image, ``(fiber, to offset, from offset)``.
    """
    first, last = offsets[:, :1], offsets[:, -1:]
    middle = 0.5 * (offsets[:, 1:] + offsets[:, :-1])
    low = center[:, None] + np.concatenate([2 * first - middle[:, :1], middle], axis=1)
    high = center[:, None] + np.concatenate([middle, 2 * last - middle[:, -1:]], axis=1)
    bound = half_length[:, None]
    keep = np.clip(np.minimum(high, bound) - np.maximum(low, -bound), 0.0, None) / (high - low)
    count = offsets.shape[1]
    fold = np.zeros((len(center), count, count))
    for fiber, (place, end) in enumerate(zip(center, half_length, strict=True)):
        for light in range(count):
            for sign, begin, stop in (
                (-1, low[fiber, light], min(high[fiber, light], -end)),
                (1, max(low[fiber, light], end), high[fiber, light]),
            ):
                if stop > begin:
                    image = max(2 * end - sign * 0.5 * (begin + stop), -end) * sign - place
                    weights = linear_weights(np.array([image]), offsets[fiber])[0]
                    beyond = (stop - begin) / (high[fiber, light] - low[fiber, light])
                    fold[fiber, :, light] += returned[fiber, (sign + 1) // 2] * beyond * weights
    return keep, fold


def _returned(scene: Scene, end: Edge) -> float:
    """Return how much of the light beyond an end of a layer, at the edge ``end``, comes back.

    Where the layer goes on round the corner its walls send light back. Where it ends: about half of
    what comes back there scattered back in the endless layer as well.
    """
    walls, paint = _wall_reflectance(scene), scene.finish(end).paint
    if end in scene.diffuser_edges:
        return walls
    return 0.5 * (walls if paint is None else paint.reflectance)


def _wall_reflectance(scene: Scene) -> float:
    """Return the reflectance of a dielectric face for diffuse light from inside."""
    cosine = np.linspace(0.0, 1.0, 2001)
    reflected = fresnel(cosine, 1 / scene.pad.index)[0]
    return float(np.trapezoid(2 * cosine * reflected, cosine))


def _half_length(scene: Scene, edge: int) -> float:
    """Return half the length (mm) of an edge's inner face."""
    return (scene.pad.width if edge in ACROSS else scene.pad.length) / 2


def _on_edges(scene: Scene, along: Array, edge: Array, heights: Array) -> Array:
    """Return positions ``(list, light, 4)`` at ``along`` ``(list, offset)`` on inner faces."""
    shape = (*along.shape, len(heights))
    spread = np.broadcast_to(along[..., None], shape)
    number = np.broadcast_to(edge[:, None, None], shape)
    side = np.where(number == EDGES.index("left"), -1.0, 1.0) * scene.pad.width / 2
    end = np.where(number == EDGES.index("base"), -1.0, 1.0) * scene.pad.length / 2
    across = np.isin(number, ACROSS)
    x = np.where(across, spread, side)
    y = np.where(across, end, spread)
    z = np.broadcast_to(heights, shape)
    return np.stack([x, y, z, number.astype(np.float64)], axis=-1).reshape(len(along), -1, 4)


def _hat_weights(place: Array, grid: Array) -> Array:
    """Return ``(light, grid point)`` weights that share lights between the nearest two points."""
    step = grid[1] - grid[0]
    return np.asarray(np.maximum(1 - np.abs(place[:, None] - grid) / step, 0.0))


def _packed(radiance: Array) -> Array:
    padding = np.zeros((*radiance.shape[:-1], 4 * TEXELS - TERMS))
    return np.concatenate([radiance, padding], axis=-1)
