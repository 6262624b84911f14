"""Directions from which the light of each lamp arrives at the coating, learned from photons.

Light comes to a facet through faces, over the lower one, walls and ends, in many orders. Where
these are smooth no connection finds these ways, and no formula aims at all of them: a concave face
shows a lamp several times. So photons are followed from each lamp to the coating, or to a wall that
is painted white, and the directions in which they arrive there are counted, per lamp and *place*: a
cube of space, and the way that the surface faces. Camera subpaths draw directions from these counts
(path guiding, Vorba et al. 2014, by histograms). What they miss other directions find, with the
density of all of them together in the MIS weights: counts cost time, not truth.

A lamp that is near lies elsewhere for each point of a cube. So what is counted is the direction
from the middle of the cube to where the photon seems to come from, on a sphere about the point
whose radius is the mean length of their ways (parallax, after Ruppert et al. 2020).
"""

from __future__ import annotations

from typing import TypeAlias

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from render.arrays import Array
from render.cells.fiber_light import FiberLight
from render.paths.vertex import Vertex, channel_mean, empty_vertex
from render.paths.walk import begin_subpath, sample_scattering, trace_segment
from render.sampling.streams import HashedStream, key, tea

Numbered: TypeAlias = "NDArray[np.int64]"
"""Which place or bin each photon or slot is of."""

PHOTONS, PHOTONS_OF_LAMP = 1 << 19, 1 << 17
"""Photons in all, and of one lamp at most: a second of a core for a quarter of a million."""
LEAST_PHOTONS = 1 << 14
"""Photons of one lamp at least, however many there are."""
EVENTS = 24
"""Faces that a photon may pass."""
CUBES = 20
"""Cubes along the longest side of what photons meet."""
FACING = 4
"""Ways to face, along each side of the square that the sphere of normals is unfolded to."""
HEIGHTS, AZIMUTHS = 48, 96
"""Bins of directions, all of one solid angle."""
BINS = HEIGHTS * AZIMUTHS
SLOTS = 1152
"""Of equal probability, by which bins are drawn."""
AROUND = 256.0
"""Photons of a place that all of its cube together, seen from there, count as."""
BESIDE = 0.1
"""Photons that a bin counts for each bin about it where one came: what shows a lamp moves from
place to place, and a bin that only cosines find has a hundred times the light of the others."""
COSINE_MIN = 0.1
"""Least cosine of arrival when photons are counted as radiance."""
NEAREST = 1.5
"""Least radius of the spheres on which photons seem to begin, in sides of a cube."""


class ArrivingLight:
    """What arrives in one pad from each of the ``fibers`` lamps of ``light``, at one bend."""

    def __init__(self, pad: mi.Scene, light: FiberLight, fibers: int) -> None:
        """Follow photons in ``pad`` and upload what they say."""
        photons = int(np.clip(PHOTONS // fibers, LEAST_PHOTONS, PHOTONS_OF_LAMP))
        found = [_Arrivals(pad, light, fiber, photons) for fiber in range(fibers)]
        # One more, so that a pad where none arrives has a place.
        points = np.concatenate([np.zeros((1, 3)), *(each.point for each in found)])
        low, high = points.min(axis=0), points.max(axis=0)
        size = float((high - low).max()) / CUBES or 1.0
        counts = (1.0001 * (high - low) / size).astype(np.int32) + 1
        self._low, self._per_size = mi.Point3f(*low.tolist()), mi.Float(1 / size)
        self._cubes, self._last = mi.Vector3i(*counts.tolist()), mi.Vector3i(*(counts - 1).tolist())
        places = int(counts.prod()) * FACING**2
        self._places = mi.UInt32(places)
        dr.make_opaque(self._low, self._per_size, self._cubes, self._last, self._places)
        # Row 0 is for places where no photon came: all directions alike.
        rows = np.zeros((fibers, places), dtype=np.uint32)
        bins: list[Numbered] = [np.arange(SLOTS)[None] * BINS // SLOTS]
        radii: list[Array] = [np.ones(1)]
        for fiber, arrivals in enumerate(found):
            if not len(arrivals.weight):
                continue
            place, middle, _ = self._place(
                mi.Point3f(arrivals.point.T), mi.Normal3f(arrivals.normal.T)
            )
            own, number = np.unique(np.array(place), return_inverse=True)
            cube, of_cube = np.unique(own // FACING**2, return_inverse=True)
            radius = np.maximum(arrivals.mean_distance(of_cube[number], len(cube)), NEAREST * size)
            arrivals.seen_from(np.array(middle).T, radius[of_cube[number]])
            rows[fiber, own] = sum(len(drawn) for drawn in bins) + np.arange(len(own))
            bins.append(_slots(_shares(of_cube, number, arrivals)))
            radii.append(radius[of_cube])
        drawn = np.concatenate(bins)
        density = np.zeros((len(drawn), BINS), dtype=np.float32)
        each = np.arange(len(drawn))[:, None]
        np.add.at(density, (each, drawn), BINS / (4 * np.pi * SLOTS))
        density[0] = 1 / (4 * np.pi)
        self._rows = mi.UInt32(rows.ravel())
        self._drawn = mi.UInt32(drawn.ravel().astype(np.uint32))
        self._density = mi.Float(density.ravel())
        self._radii = mi.Float(np.concatenate(radii).astype(np.float32))
        dr.make_opaque(self._rows, self._drawn, self._density, self._radii)

    def sample(
        self, fiber: mi.UInt32, v: Vertex, pick: mi.Float, x: mi.Float, y: mi.Float
    ) -> mi.Vector3f:
        """Return directions from ``v`` to where light of ``fiber`` comes from."""
        row, off = self._row(fiber, v)
        slot = dr.minimum(mi.UInt32(pick * SLOTS), SLOTS - 1)
        number = dr.gather(mi.UInt32, self._drawn, row * SLOTS + slot)
        # Where no photon came a slot is as many bins, side by side.
        y = y * dr.select(row == 0, mi.Float(BINS // SLOTS), 1.0)
        height = number // AZIMUTHS
        z = (mi.Float(height) + x) * (2.0 / HEIGHTS) - 1.0
        turn = (mi.Float(number - height * AZIMUTHS) + y) * (2.0 * dr.pi / AZIMUTHS) - dr.pi
        sine, cosine = dr.sincos(turn)
        level = dr.safe_sqrt(1.0 - dr.square(z))
        seen = mi.Vector3f(level * cosine, level * sine, z)
        # From the middle of the cube to the sphere about the point.
        radius, along = dr.gather(mi.Float, self._radii, row), dr.dot(seen, off)
        reach = dr.square(along) + dr.square(radius) - dr.squared_norm(off)
        direction = dr.normalize((along + dr.safe_sqrt(reach)) * seen - off)
        return dr.select(row == 0, seen, direction)

    def density(self, fiber: mi.UInt32, v: Vertex, direction: mi.Vector3f) -> mi.Float:
        """Return the density per solid angle with which ``sample`` finds ``direction``."""
        row, off = self._row(fiber, v)
        radius = dr.gather(mi.Float, self._radii, row)
        seen = off + radius * direction
        squared = dr.squared_norm(seen)
        seen = dr.select(row == 0, direction, seen * dr.rsqrt(squared))
        # Solid angles are as areas of the sphere over squared distances.
        spread = dr.square(radius) * dr.dot(direction, seen) / squared
        density = dr.gather(mi.Float, self._density, row * BINS + _bin(seen))
        return density * dr.select(row == 0, 1.0, spread)

    def _row(self, fiber: mi.UInt32, v: Vertex) -> tuple[mi.UInt32, mi.Vector3f]:
        """Return the rows of vertices, and where they are from the middle of their cubes."""
        place, middle, within = self._place(v.p, v.n)
        row = dr.gather(mi.UInt32, self._rows, fiber * self._places + place, within)
        return row, mi.Vector3f(v.p - middle)

    def _place(self, p: mi.Point3f, n: mi.Normal3f) -> tuple[mi.UInt32, mi.Point3f, mi.Bool]:
        """Return the places of points, the middle of their cubes, and whether photons came so far.

        A place has a normal as well; mm.
        """
        cube = mi.Vector3i(dr.floor((p - self._low) * self._per_size))
        within = dr.all((cube >= 0) & (cube <= self._last))
        cube = dr.clip(cube, 0, self._last)
        at = (cube.x * self._cubes.y + cube.y) * self._cubes.z + cube.z
        # The octahedron about the sphere, unfolded (Cigolle et al. 2014).
        n = n * dr.rcp(dr.abs(n.x) + dr.abs(n.y) + dr.abs(n.z))
        x = dr.select(n.z < 0, dr.mulsign(1.0 - dr.abs(n.y), n.x), n.x)
        y = dr.select(n.z < 0, dr.mulsign(1.0 - dr.abs(n.x), n.y), n.y)
        i, j = (_step((a + 1.0) * 0.5, FACING) for a in (x, y))
        middle = self._low + (mi.Vector3f(cube) + 0.5) / self._per_size
        return (mi.UInt32(at) * FACING + i) * FACING + j, mi.Point3f(middle), within


class _Arrivals:
    """Photons of one lamp that have met a diffuse surface, at the ``point (photon, 3)``.

    ``normal`` is that of the surface and ``side`` the same towards the light, ``direction`` where
    they come from, from so much ``distance`` (mm), ``cosine`` that of arrival and ``weight`` what
    they are worth. ``bin`` is the direction that is counted.
    """

    bin: Numbered

    def __init__(self, pad: mi.Scene, light: FiberLight, fiber: int, photons: int) -> None:
        """Follow so many ``photons`` until they meet a diffuse surface."""
        v, length = _followed(pad, light, dr.opaque(mi.UInt32, fiber), photons)
        weight = np.array(channel_mean(v.beta), dtype=np.float64)
        lit = weight > 0
        # In photons of the mean.
        self.weight = weight[lit] / weight[lit].mean() if lit.any() else weight[lit]
        self.point, self.normal = np.array(v.p).T[lit], np.array(v.n).T[lit]
        self.direction = np.array(v.wi).T[lit]
        self.distance = np.array(length, dtype=np.float64)[lit]
        cosine = np.array(dr.dot(v.n, v.wi), dtype=np.float64)[lit]
        self.cosine, self.side = np.abs(cosine), self.normal * np.sign(cosine)[:, None]

    def mean_distance(self, cube: Numbered, cubes: int) -> Array:
        """Return the mean length of ways to each of so many ``cubes``, mm: by its inverse."""
        inverse = np.bincount(cube, self.weight / np.maximum(self.distance, 1e-3), cubes)
        return np.asarray(np.bincount(cube, self.weight, cubes) / inverse)

    def seen_from(self, middle: Array, radius: Array) -> None:
        """Take the directions from a ``middle`` (photon, 3) to spheres about the points, mm."""
        seen = self.point + radius[:, None] * self.direction - middle
        seen /= np.linalg.norm(seen, axis=1, keepdims=True)
        self.bin = np.array(_bin(mi.Vector3f(seen.T.astype(np.float32))))


@dr.syntax
def _followed(
    pad: mi.Scene, light: FiberLight, fiber: mi.UInt32, photons: int
) -> tuple[Vertex, mi.Float]:
    """Return the first diffuse surface that photons of ``fiber`` meet, with ``beta`` 0 if none.

    The second value is how far they went from their lamp, or from where a volume scattered them.
    """
    lane = dr.arange(mi.UInt32, photons)
    seed, _ = tea([lane, key(0, 4, 0)])
    stream = HashedStream(seed ^ fiber)
    pick_node, u, v_angle, free = stream.event(mi.UInt32(0))
    x, y, _, _ = stream.event(mi.UInt32(1))
    stratum = (mi.Float(lane) + pick_node) / dr.opaque(mi.Float, photons)
    o, d = light.sample(fiber, stratum, (u, v_angle), mi.Point2f(x, y))
    none = mi.Float(0)
    state = begin_subpath(o, d, dr.zeros(mi.MediumPtr), mi.Spectrum(1.0), none, none, free)
    met, last, length = empty_vertex(), mi.Point3f(o), mi.Float(0.0)
    event, active = mi.UInt32(2), dr.full(mi.Bool, True, photons)
    while active:
        state, v, arrived, escaped = trace_segment(pad, state, active)
        length += dr.select(arrived, dr.norm(v.p - last), 0.0)
        last = dr.select(arrived, v.p, last)
        here = arrived & v.diffuse
        met = dr.select(here, v, met)
        going = arrived & ~v.diffuse
        length = dr.select(going & v.volume, 0.0, length)
        state, alive = sample_scattering(
            state, v, mi.TransportMode.Importance, stream.event(event), going
        )
        event += 1
        active &= ~escaped & ~here & (~going | alive) & (event < EVENTS + 2)
    return met, length


def _bin(direction: mi.Vector3f) -> mi.UInt32:
    turn = dr.atan2(direction.y, direction.x) * (0.5 / dr.pi) + 0.5
    return _step((direction.z + 1.0) * 0.5, HEIGHTS) * AZIMUTHS + _step(turn, AZIMUTHS)


def _step(part: mi.Float, count: int) -> mi.UInt32:
    """Return which of ``count`` steps of [0, 1] a part is in; any for what is not a number."""
    return mi.UInt32(dr.clip(mi.Int32(part * count), 0, count - 1))


def _middles() -> Array:
    """Return the directions in the middle of all bins, ``(bin, 3)``."""
    height, azimuth = np.divmod(np.arange(BINS), AZIMUTHS)
    z = (height + 0.5) * (2 / HEIGHTS) - 1
    turn = (azimuth + 0.5) * (2 * np.pi / AZIMUTHS) - np.pi
    level = np.sqrt(1 - z**2)
    return np.stack([level * np.cos(turn), level * np.sin(turn), z], axis=1)


def _shares(cube: Numbered, number: Numbered, arrivals: _Arrivals) -> Array:
    """Return how often bins are to be drawn, ``(place, bin)``.

    Arguments:
        cube: that of each place, counted from 0 without gaps.
        number: the place of each photon.
        arrivals: the photons.

    A facet that few photons reach is told by those of its cube what may come over its horizon.
    """
    places, at = len(cube), number * BINS + arrivals.bin
    counts: Array = np.zeros(places * BINS)
    counts += np.bincount(at, arrivals.weight, len(counts))
    counts = counts.reshape(places, BINS)
    radiance = arrivals.weight / np.maximum(arrivals.cosine, COSINE_MIN)
    bins = (int(cube.max()) + 1) * BINS
    together = np.bincount(cube[number] * BINS + arrivals.bin, radiance, bins)
    facing: Array = np.zeros((places, 3))
    facing += np.stack([np.bincount(number, n, places) for n in arrivals.side.T], axis=1)
    length = np.linalg.norm(facing, axis=1, keepdims=True)
    facing /= np.where(length > 0, length, 1.0)
    around = together.reshape(-1, BINS)[cube] * np.maximum(facing @ _middles().T, 0.0)
    total = around.sum(axis=1, keepdims=True)
    counts += AROUND * around / np.where(total > 0, total, 1.0)
    counts += BESIDE * _lit_beside(counts > 0)
    # A lamp fills a bin in part: where h of its directions meet it, photons count h, and variance
    # is least for densities that go by the root of h.
    return np.sqrt(counts)


def _lit_beside(lit: NDArray[np.bool_]) -> Array:
    """Return how many bins are ``lit (place, bin)`` of each and the eight about it."""
    grid = lit.reshape(-1, HEIGHTS, AZIMUTHS).astype(np.float64)
    grid = grid + np.roll(grid, 1, axis=2) + np.roll(grid, -1, axis=2)
    # There is nothing beyond the poles.
    grid = np.pad(grid, ((0, 0), (1, 1), (0, 0)))
    return np.asarray((grid[:, :-2] + grid[:, 1:-1] + grid[:, 2:]).reshape(lit.shape))


def _slots(shares: Array) -> Numbered:
    """Return the bins of `SLOTS` slots per row, ``(place, slot)``, in proportion to ``shares``."""
    middle = (np.arange(SLOTS) + 0.5) / SLOTS
    sums = np.cumsum(shares, axis=1)
    return np.stack([np.searchsorted(row, middle * row[-1]) for row in sums])
