"""Connecting camera and light vertices over one reflection in any flat glossy face of a scene.

Connecting to a vertex on a glossy face mostly misses its narrow lobe. A mirror connection instead
mirrors the light vertex in the face's plane, draws a direction from the camera vertex close to the
mirror image, as wide as the roughness makes the reflection, and lets it find the face
(``render.paths.connect.mirror_connection``). What it counts in the balance heuristic is said in
``render.paths.mirrors``.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from render.integrators.planar_mirrors import (
    COSINE_BINS,
    PLANE_TOLERANCE,
    PlanarMirror,
    find_mirrors,
)
from render.paths.connect import mirror_connection
from render.paths.mirrors import SubpathTail
from render.paths.reflection_lobe import ReflectionLobe
from render.paths.vertex import Vertex, has_wide_lobe

GLOSSY_WEIGHT = 0.1
"""What connections of a glossy camera vertex to a volume or a diffuse surface count.

Narrow lobes make them noisy, while camera subpaths that go on from there meet the same light.
"""
MISS_DISTANCE = 0.1
"""Relative to the length of the way: a mirror that the straight reflection misses by so much is
half as likely."""
LENGTH_BLUR = 0.05
"""Distance, relative to the mirrors' extent, up to which proxy weights do not tell ways over them
apart by their length."""


class MirrorSet:
    """The mirrors of a scene, and the densities of mirror connections over them."""

    def __init__(self, mirrors: list[PlanarMirror]) -> None:
        """Upload ``mirrors``, of which there is at least one."""
        low = np.min([m.low for m in mirrors], axis=0)
        size = float((np.max([m.high for m in mirrors], axis=0) - low).max())
        self.count = len(mirrors)
        rows = [
            (*m.normal, m.offset, *(0.5 * (m.low + m.high)), *(0.5 * (m.high - m.low)), m.slope)
            for m in mirrors
        ]
        self.columns = [mi.Float(column.astype(np.float32)) for column in np.array(rows).T]
        self.tolerance = mi.Float(PLANE_TOLERANCE * size)
        self.blur = mi.Float((LENGTH_BLUR * size) ** 2)
        table = np.concatenate([m.reflectance.ravel() for m in mirrors])
        self.reflectance = mi.Float(table.astype(np.float32))
        dr.make_opaque(self.columns, self.tolerance, self.blur, self.reflectance)

    @staticmethod
    def of(scene: mi.Scene) -> MirrorSet | None:
        """Return the mirrors of a Mitsuba scene; None where there are none to connect over."""
        mirrors = find_mirrors(scene)
        return MirrorSet(mirrors) if mirrors else None

    def _numbers(self, k: mi.UInt32, first: int, count: int) -> list[mi.Float]:
        return [dr.gather(mi.Float, column, k) for column in self.columns[first : first + count]]

    def _height(self, k: mi.UInt32, p: mi.Point3f) -> mi.Float:
        x, y, z, offset = self._numbers(k, 0, 4)
        return x * p.x + y * p.y + z * p.z - offset

    def _selection_weight(self, k: mi.UInt32, a: mi.Point3f, y: mi.Point3f) -> mi.Float:
        """Return how likely a connection from ``a`` to ``y`` uses mirror ``k``, not normalized."""
        height_a, height_y = self._height(k, a), self._height(k, y)
        normal = mi.Vector3f(*self._numbers(k, 0, 3))
        way = y - 2.0 * height_y * normal - a
        squared = dr.maximum(dr.squared_norm(way), dr.square(self.tolerance))
        fraction = dr.abs(height_a) / dr.maximum(dr.abs(height_a) + dr.abs(height_y), 1e-20)
        beside = dr.abs(a + fraction * way - mi.Point3f(*self._numbers(k, 4, 3)))
        beside = dr.maximum(beside - mi.Vector3f(*self._numbers(k, 7, 3)), 0.0)
        missed = dr.squared_norm(beside) / (squared * MISS_DISTANCE * MISS_DISTANCE)
        # A vertex in the mirror's own plane has no reflection there.
        off_plane = dr.minimum(dr.abs(height_a), dr.abs(height_y)) > self.tolerance
        fits = off_plane & (height_a * height_y > 0)
        cosine = (dr.abs(height_a) + dr.abs(height_y)) * dr.rsqrt(squared)
        step = dr.minimum(mi.UInt32(cosine * COSINE_BINS), COSINE_BINS - 1)
        row = 2 * k + dr.select(height_a > 0, mi.UInt32(1), 0)
        reflectance = dr.gather(mi.Float, self.reflectance, row * COSINE_BINS + step)
        return dr.select(fits, reflectance / (squared * (1.0 + missed)), 0.0)

    def _selection_weights(self, a: mi.Point3f, y: mi.Point3f) -> tuple[list[mi.Float], mi.Float]:
        """Return the weight of each mirror, and their sum."""
        each = [self._selection_weight(mi.UInt32(k), a, y) for k in range(self.count)]
        return each, sum(each[1:], each[0])

    def lobe(self, k: mi.UInt32, a: mi.Point3f, y: mi.Point3f) -> ReflectionLobe:
        """Return the directions from ``a`` over mirror ``k`` about the image of ``y``."""
        normal = mi.Vector3f(*self._numbers(k, 0, 3))
        height_a, height_y = self._height(k, a), self._height(k, y)
        (slope,) = self._numbers(k, 10, 1)
        image = y - 2.0 * height_y * normal
        return ReflectionLobe.towards(a, image, normal, dr.abs(height_a), dr.abs(height_y), slope)

    def mirror_at(self, p: mi.Point3f, normal: mi.Normal3f) -> mi.UInt32:
        """Return the number of the mirror that a surface point lies in; ``count`` for none."""
        number = mi.UInt32(self.count)
        for i in reversed(range(self.count)):
            k = mi.UInt32(i)
            facing = dr.abs(dr.dot(mi.Vector3f(*self._numbers(k, 0, 3)), mi.Vector3f(normal)))
            inside = (facing > 1.0 - 1e-5) & (dr.abs(self._height(k, p)) < self.tolerance)
            number = dr.select(inside, k, number)
        return number

    def select(self, a: mi.Point3f, y: mi.Point3f, pick: mi.Float) -> tuple[mi.UInt32, mi.Float]:
        """Return a mirror, selected by ``pick``, and the probability; 0 where none fits."""
        each, total = self._selection_weights(a, y)
        k = mi.UInt32(0)
        selected, below = each[0], each[0]
        for i in range(1, self.count):
            beyond = (pick * total >= below) & (each[i] > 0)
            k = dr.select(beyond, mi.UInt32(i), k)
            selected = dr.select(beyond, each[i], selected)
            below = below + each[i]
        return k, dr.select(total > 0, selected / dr.maximum(total, 1e-30), 0.0)

    def likely_image(self, a: mi.Point3f, y: mi.Point3f) -> mi.Point3f:
        """Return the image of ``a`` in the mirror that connections to ``y`` select most often."""
        k, highest = mi.UInt32(0), mi.Float(0.0)
        for i, weight in enumerate(self._selection_weights(a, y)[0]):
            k = dr.select(weight > highest, mi.UInt32(i), k)
            highest = dr.maximum(weight, highest)
        return self.image(k, a, y)[1]

    def image(
        self, k: mi.UInt32, a: mi.Point3f, y: mi.Point3f
    ) -> tuple[mi.Vector3f, mi.Point3f, mi.Float]:
        """Return the normal of mirror ``k``, the image of ``a`` in it, and its selection weight."""
        normal = mi.Vector3f(*self._numbers(k, 0, 3))
        image = a - 2.0 * self._height(k, a) * normal
        return normal, image, self._selection_weight(k, a, y)

    def area_density(
        self, a: mi.Point3f, b: mi.Point3f, normal: mi.Normal3f, y: mi.Point3f
    ) -> mi.Float:
        """Return the density per area with which a connection from ``a`` to ``y`` finds ``b``.

        ``normal`` is the surface's at ``b``; 0 where ``b`` is in no mirror.
        """
        k = self.mirror_at(b, normal)
        known = k < self.count
        k = dr.minimum(k, self.count - 1)
        _, total = self._selection_weights(a, y)
        probability = self._selection_weight(k, a, y) / dr.maximum(total, 1e-30)
        density = self.lobe(k, a, y).area_density(a, b, normal, probability)
        return dr.select(known & (probability > 0), density, 0.0)

    def connect(
        self, scene: mi.Scene, y: Vertex, a: Vertex, k: mi.UInt32, probability: mi.Float,
        numbers: tuple[mi.Float, mi.Float], active: mi.Bool,
    ) -> mi.Spectrum:  # fmt: skip
        """Return the MIS-weighted light that camera vertex ``a`` gets from ``y`` over mirror ``k``.

        Both are in volumes or diffuse; the mirror was selected with ``probability``, and that is
        divided by.
        """
        return mirror_connection(
            scene, y, a, self.lobe(k, a.p, y.p), numbers, active & (probability > 0), probability,
            in_mirror=lambda b: self.mirror_at(b.p, b.n) == k, glossy=GLOSSY_WEIGHT,
        )  # fmt: skip


def connection_weight(
    v: Vertex, tail: SubpathTail, from_camera: mi.Bool, first: mi.Bool
) -> mi.Float:
    """Return what connections between ``v`` and the end of its subpath's ``tail`` count.

    ``v`` is the ``first`` vertex of the subpath or not.
    """
    wide = has_wide_lobe(v)
    wide_z, wide_y = (
        dr.select(from_camera, tail.wide, wide),
        dr.select(from_camera, wide, tail.wide),
    )
    return dr.select(~wide_z & wide_y & ~first, GLOSSY_WEIGHT, 1.0)
