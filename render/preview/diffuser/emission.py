"""Light of one fiber on its way into the diffusive layer, for many directions at once.

Rays are drawn from the mixture of all phi nodes and carry one weight per node, so that a single
set of walks serves every node (multiple importance sampling with the balance heuristic, Veach
1997, ch. 9) and the response is smooth in phi.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from render.arrays import Array
from render.geometry import sample_rough_face
from render.preview.diffuser.random_walk import Photons, Slab, deflect, tangent_frame
from render.scene import Profile


@dataclass(frozen=True)
class FiberEnd:
    """A fiber end: ``diameter``, ``gap`` and ``height`` in mm, ``tilt`` in rad.

    A disk normal to the beam with the radiance of ``profile``. Below 0 ``gap`` is how deep it is
    in the layer.
    """

    diameter: float
    gap: float
    height: float
    tilt: float
    profile: Profile

    def directions(self, phi: Array) -> Array:
        """Return unit beam directions ``(..., 3)`` in the layer's frame."""
        flat = np.cos(self.tilt)
        return np.stack(
            [flat * np.cos(phi), flat * np.sin(phi), np.full_like(phi, np.sin(self.tilt))], axis=-1
        )

    def radiance(self, theta: Array) -> Array:
        """Return the radiance, on-axis 1, at angles ``theta`` (rad) from the beam."""
        return self.profile.radiance(theta)

    @property
    def peak_intensity(self) -> float:
        """Return the on-axis intensity (1/sr) of a fiber end that emits unit power."""
        theta, density = self._density()
        return 1.0 / float(2 * np.pi * np.trapezoid(density, theta))

    def _density(self) -> tuple[Array, Array]:
        # Steps shrink with the beam, so that its profile is resolved however narrow it is.
        width = self.profile.sigma_v or np.pi
        theta = np.minimum(12 * width, np.pi / 2) * np.linspace(0, 1, 4001)
        return theta, self.radiance(theta) * np.sin(theta) * np.cos(theta)

    def flux(self) -> tuple[Array, Array]:
        """Return angles (rad) and the part of the flux within each (last entry: 1)."""
        theta, density = self._density()
        total = np.concatenate([[0], np.cumsum(0.5 * (density[1:] + density[:-1]))])
        return theta, total / total[-1]


def emit_from_fiber(
    slab: Slab, fiber_end: FiberEnd, phi: Array, count: int, rng: np.random.Generator
) -> tuple[Photons, Array]:
    """Return photons just inside the outer face and their weight per node ``(photon, node)``.

    Photons of an end in the layer begin there.

    Per node the weights of ``count`` launched rays, times the photons' own, estimate a unit power;
    light that misses the layer or is reflected by its outer face is missing from the sum.
    """
    axes = fiber_end.directions(phi)
    node = rng.integers(0, len(phi), count)
    theta, flux_fraction = fiber_end.flux()
    angle = np.interp(rng.random(count), flux_fraction, theta)
    s, t = tangent_frame(axes[node])
    direction = deflect(axes[node], np.cos(angle), rng).astype(np.float64)
    radius = 0.5 * fiber_end.diameter * np.sqrt(rng.random(count))
    azimuth = 2 * np.pi * rng.random(count)
    center = np.array([0.0, -fiber_end.gap, fiber_end.height])
    origin = center + radius[:, None] * (
        np.cos(azimuth)[:, None] * s + np.sin(azimuth)[:, None] * t
    )
    if fiber_end.gap < 0.0:
        weight = radiance_of_nodes(fiber_end, axes, origin - center, direction)
        weight /= weight.mean(axis=1, keepdims=True) * count
        start, way = origin.astype(np.float32), direction.astype(np.float32)
        one, straight = np.ones(count, np.float32), np.ones(count, dtype=bool)
        return Photons(start, way, one, np.arange(count), straight), weight
    inward = direction[:, 1] > 1e-6
    distance = np.where(inward, -origin[:, 1], 0.0) / np.where(inward, direction[:, 1], 1.0)
    hit = origin + distance[:, None] * direction
    hit[:, 1] = 0.0
    arrives = inward & (hit[:, 2] > 0) & (hit[:, 2] < slab.height)
    origin, direction, hit = origin[arrives], direction[arrives], hit[arrives]
    weight = radiance_of_nodes(fiber_end, axes, origin - center, direction)
    weight /= weight.mean(axis=1, keepdims=True) * count
    met = sample_rough_face(direction.astype(np.float32), 1, slab.outer_roughness, slab.index, rng)
    straight = np.ones(len(hit), dtype=bool)
    photons = Photons(
        hit.astype(np.float32), met.refracted, met.transmission, np.arange(len(hit)), straight
    )
    return photons[met.transmission > 0], weight


def radiance_of_nodes(fiber_end: FiberEnd, axes: Array, offset: Array, direction: Array) -> Array:
    """Return the radiance ``(photon, node)`` that each node's fiber end sends along each ray."""
    cos = direction @ axes.T
    safe = np.where(np.abs(cos) > 1e-9, cos, 1e-9)
    # Where the ray's line meets the node's disk, seen from the disk's center.
    disk = offset[:, None] - direction[:, None] * ((offset @ axes.T) / safe)[..., None]
    # The node that drew the ray must count as hit in spite of rounding.
    inside = (cos > 0) & (
        np.einsum("pni,pni->pn", disk, disk) <= (fiber_end.diameter / 2) ** 2 * 1.0001
    )
    sin = np.linalg.norm(np.cross(direction[:, None], axes[None]), axis=-1)
    return np.where(inside, fiber_end.radiance(np.arctan2(sin, cos)), 0.0)


def emit_diffuse(slab: Slab, count: int, rng: np.random.Generator) -> Photons:
    """Return photons that enter through the inner face, cosine distributed, uniform in height."""
    u, azimuth = rng.random(count), 2 * np.pi * rng.random(count)
    sin = np.sqrt(u)
    direction = np.stack([sin * np.cos(azimuth), -np.sqrt(1 - u), sin * np.sin(azimuth)], axis=-1)
    position = np.zeros_like(direction)
    position[:, 1] = slab.thickness
    position[:, 2] = slab.height * rng.random(count)
    weight = np.full(count, 1 / count, dtype=np.float32)
    return Photons(
        position.astype(np.float32),
        direction.astype(np.float32),
        weight,
        np.arange(count),
        np.ones(count, dtype=bool),
    )
