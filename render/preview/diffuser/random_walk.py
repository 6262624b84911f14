"""A random walk of light in the diffusive layer: numpy, all photons at once.

Local frame of one edge (mm): column 0 ``a`` runs along the edge (towards phi = 0), column 1 ``d``
into the pad (0 at the outer face, ``thickness`` at the inner one), column 2 ``z`` from the
camera-side face (0) to the coating side (``height``). The layer is endless along ``a``. Light
leaves unhindered through the inner face (index matched) and meets a rough dielectric on the others.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from render.geometry import Floats, sample_rough_face

ROULETTE_EVENTS = 400
"""Events after which photons play Russian roulette, so that any walk ends."""
SURVIVAL_PROBABILITY = 0.95


@dataclass(frozen=True)
class Slab:
    """The layer: lengths in mm, coefficients in 1/mm, ``roughness`` Beckmann alpha.

    ``outer`` and ``lower`` are the roughness of these two faces where it is another.
    """

    thickness: float
    height: float
    sigma_s: float
    sigma_a: float
    g: float
    index: float
    roughness: float
    outer: float | None = None
    lower: float | None = None

    @property
    def outer_roughness(self) -> float:
        """Return that of the face to the lamps."""
        return self.roughness if self.outer is None else self.outer

    @property
    def lower_roughness(self) -> float:
        """Return that of the face on the camera's side."""
        return self.roughness if self.lower is None else self.lower

    @property
    def optical_thickness(self) -> float:
        """Return the extinction times the thickness."""
        return self.optical_depth(self.thickness)

    def optical_depth(self, length: float) -> float:
        """Return the extinction times a ``length`` in mm."""
        return (self.sigma_s + self.sigma_a) * length


@dataclass(frozen=True)
class Photons:
    """A bundle of light: position and unit direction ``(photon, 3)``, weight ``(photon,)``.

    ``label`` ``(photon,)`` is the number of the photon that was launched; ``straight``
    ``(photon,)`` says that the lower face alone has turned it.
    """

    position: Floats
    direction: Floats
    weight: Floats
    label: NDArray[np.int64]
    straight: NDArray[np.bool_]

    def __getitem__(self, chosen: NDArray[np.bool_] | NDArray[np.int64]) -> Photons:
        """Return the chosen photons."""
        return Photons(*(getattr(self, field.name)[chosen] for field in fields(self)))


OUTER, INNER, LOWER, UPPER = range(4)
"""Numbers of the faces: d = 0, d = thickness, z = 0, z = height."""


def walk(slab: Slab, photons: Photons, rng: np.random.Generator) -> tuple[Photons, int]:
    """Return the photons that leave through the inner face and the number of events it took.

    Free paths are drawn from ``sigma_s``; absorption is carried as a weight.
    """
    rounds = events = 0
    portions: list[Photons] = []
    # Directions are turned in place below; the caller's stay as they are.
    photons = replace(photons, direction=photons.direction.copy())
    while len(photons.weight):
        position, direction = photons.position, photons.direction
        face_distance, face = _distance_to_face(slab, position, direction)
        free_path = _free_path(slab, len(face_distance), rng)
        scatters = free_path < face_distance
        step = np.where(scatters, free_path, face_distance)
        position = position + step[:, None] * direction
        weight = photons.weight * np.exp(np.float32(-slab.sigma_a) * step)
        leaves = ~scatters & (face == INNER)
        straight = photons.straight & ~scatters & (face != OUTER) & (face != UPPER)
        portions.append(Photons(position, direction, weight, photons.label, straight)[leaves])
        direction[scatters] = sample_henyey_greenstein(direction[scatters], slab.g, rng)
        for number, axis, level, roughness in (
            (OUTER, 1, 0.0, slab.outer_roughness),
            (LOWER, 2, 0.0, slab.lower_roughness),
            (UPPER, 2, slab.height, slab.roughness),
        ):
            met = np.nonzero(~scatters & (face == number))[0]
            sample = sample_rough_face(direction[met], axis, roughness, 1 / slab.index, rng)
            position[met, axis] = level
            direction[met] = sample.reflected
            weight[met] *= sample.reflection
        stays = ~leaves & (weight > 0)
        rounds, events = rounds + 1, events + len(weight)
        if rounds > ROULETTE_EVENTS:
            stays &= rng.random(len(weight), dtype=np.float32) < SURVIVAL_PROBABILITY
            weight /= np.float32(SURVIVAL_PROBABILITY)
        photons = Photons(position, direction, weight, photons.label, straight)[stays]
    return _joined(portions or [photons]), events


def _joined(portions: list[Photons]) -> Photons:
    columns = (
        np.concatenate([getattr(portion, field.name) for portion in portions])
        for field in fields(Photons)
    )
    return Photons(*columns)


def _free_path(slab: Slab, count: int, rng: np.random.Generator) -> Floats:
    """Return free paths (mm) between scattering events, inf in a layer that does not scatter."""
    if slab.sigma_s == 0.0:
        return np.full(count, np.inf, dtype=np.float32)
    return rng.standard_exponential(count, dtype=np.float32) / np.float32(slab.sigma_s)


def _distance_to_face(
    slab: Slab, position: Floats, direction: Floats
) -> tuple[Floats, NDArray[np.int64]]:
    """Return the way (mm) to the nearest face and the number of that face."""
    with np.errstate(divide="ignore", invalid="ignore"):
        to = []
        for axis, far in ((1, slab.thickness), (2, slab.height)):
            speed = direction[:, axis]
            goal = np.where(speed > 0, np.float32(far), np.float32(0.0))
            to.append(np.where(speed != 0, (goal - position[:, axis]) / speed, np.inf))
    first = to[0] <= to[1]
    distance = np.maximum(np.where(first, to[0], to[1]), 0).astype(np.float32)
    face = np.where(first, OUTER + (direction[:, 1] > 0), LOWER + (direction[:, 2] > 0))
    return distance, face


def sample_henyey_greenstein(direction: Floats, g: float, rng: np.random.Generator) -> Floats:
    """Return directions ``(photon, 3)`` after one Henyey-Greenstein event (their eq. of 1941)."""
    n = len(direction)
    u = rng.random(n, dtype=np.float32)
    if abs(g) < 1e-3:
        cos = 2 * u - 1
    else:
        cos = (1 + g**2 - ((1 - g**2) / (1 - g + 2 * g * u)) ** 2) / (2 * g)
    return deflect(direction, np.clip(cos, -1, 1).astype(np.float32), rng)


def deflect(direction: Floats, cos: Floats, rng: np.random.Generator) -> Floats:
    """Return directions at angle ``arccos(cos)`` to the given ones, azimuth uniform."""
    azimuth = np.float32(2 * np.pi) * rng.random(len(cos), dtype=np.float32)
    sin = np.sqrt(np.maximum(1 - cos**2, 0))
    s, t = tangent_frame(direction)
    around = (sin * np.cos(azimuth))[:, None] * s + (sin * np.sin(azimuth))[:, None] * t
    return np.asarray(around + cos[:, None] * direction)


def tangent_frame(w: Floats) -> tuple[Floats, Floats]:
    """Return two unit vectors ``(photon, 3)`` normal to ``w`` (Duff et al. 2017)."""
    x, y, z = w[:, 0], w[:, 1], w[:, 2]
    sign = np.copysign(np.float32(1), z)
    a = -1 / (sign + z)
    b = x * y * a
    return (
        np.stack([1 + sign * x * x * a, sign * b, -sign * x], axis=-1),
        np.stack([b, sign + y * y * a, -y], axis=-1),
    )
