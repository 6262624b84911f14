"""What mirror connections count in the balance heuristic, and the vertices that know of them.

A mirror connection finds paths

    ... - y (volume or diffuse) - b (glossy) - a (volume or diffuse) - ...

by a direction from ``a`` about the mirror image of ``y`` (``render.paths.connect``). Wherever such
a triple lies on a path it competes with the subpaths and connections that find ``b`` otherwise. So
the recursive sums need one factor, ``shared_d_vcm``, at vertices that end a triple, and
connections at ``b`` the density ratio ``mirror_ratio``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import drjit as dr
import mitsuba as mi

from render.paths.vertex import RATIO_MAX, Vertex, empty_vertex, has_wide_lobe


class MirrorDensity(Protocol):
    """The mirrors of a scene or of a pad."""

    def area_density(
        self, a: mi.Point3f, b: mi.Point3f, normal: mi.Normal3f, y: mi.Point3f
    ) -> mi.Float:
        """Return the density per area with which a connection from ``a`` to ``y`` finds ``b``.

        ``normal`` is the surface's at ``b``; 0 where ``b`` is in no mirror.
        """


@dataclass
class KeptVertex:
    """A vertex for connections (a Dr.Jit PyTree); ``previous`` is the point before it.

    ``glossy_after_wide`` says that it is glossy and the one before it has a wide lobe, so that a
    mirror connection may find it.
    """

    vertex: Vertex
    previous: mi.Point3f
    glossy_after_wide: mi.Bool

    @staticmethod
    def none() -> KeptVertex:
        """Return one of weight 0."""
        return KeptVertex(empty_vertex(), dr.zeros(mi.Point3f), mi.Bool(False))


@dataclass
class SubpathTail:
    """The last vertices of a subpath, for the triples that they end (a Dr.Jit PyTree).

    ``p``, ``n``, ``d_vcm`` and ``wide`` (its lobe) are the last vertex's, ``previous`` is the point
    of the one before it; ``glossy_after_wide`` says that the last is glossy after a wide one.
    """

    p: mi.Point3f
    n: mi.Normal3f
    d_vcm: mi.Float
    wide: mi.Bool
    previous: mi.Point3f
    glossy_after_wide: mi.Bool

    @staticmethod
    def empty() -> SubpathTail:
        """Return the tail of a subpath that has only its end on a lens or an emitter."""
        return SubpathTail(
            dr.zeros(mi.Point3f), dr.zeros(mi.Normal3f), mi.Float(0.0), mi.Bool(False),
            dr.zeros(mi.Point3f), mi.Bool(False),
        )  # fmt: skip

    def then(self, v: Vertex) -> SubpathTail:
        """Return the tail with vertex ``v``."""
        wide = has_wide_lobe(v)
        return SubpathTail(v.p, v.n, v.d_vcm, wide, self.p, ~wide & ~v.delta & self.wide)


@dr.syntax
def _density_ratio(
    mirrors: MirrorDensity, a: mi.Point3f, b: mi.Point3f, n: mi.Normal3f, d_vcm: mi.Float,
    y: mi.Point3f, active: mi.Bool,
) -> mi.Float:  # fmt: skip
    """Return the density of mirror connections from ``a`` to ``y`` over that of finding ``b``.

    By the subpath of which ``b`` is the glossy vertex; ``n`` and ``d_vcm`` are those of ``b``.
    """
    result = mi.Float(0.0)
    if active:
        result = dr.minimum(d_vcm * mirrors.area_density(a, b, n, y), RATIO_MAX)
    return result


def shared_d_vcm(
    mirrors: MirrorDensity | None, v: Vertex, tail: SubpathTail, active: mi.Bool,
    from_camera: mi.Bool | bool,
    strategy: mi.Float | float = 1.0,
) -> mi.Float:  # fmt: skip
    """Return ``d_vcm`` of ``v`` with mirror connections at its triple.

    ``tail`` ends before ``v``; ``strategy`` is what connections between both count.
    """
    if mirrors is None:
        return v.d_vcm * strategy
    ends = active & tail.glossy_after_wide & has_wide_lobe(v)
    a = dr.select(from_camera, tail.previous, v.p)
    y = dr.select(from_camera, v.p, tail.previous)
    further = _density_ratio(mirrors, a, tail.p, tail.n, tail.d_vcm, y, ends)
    return dr.minimum(v.d_vcm * (strategy + further), RATIO_MAX)


def mirror_ratio(
    mirrors: MirrorDensity | None, y: KeptVertex, z: KeptVertex, active: mi.Bool,
    glossy: float = 1.0,
) -> mi.Float:  # fmt: skip
    """Return the density of mirror connections relative to connecting ``y`` to ``z`` directly.

    ``y`` is a light and ``z`` a camera vertex; ``glossy`` is what connections of a glossy vertex
    to a wide one count (``render.paths.connect.mirror_connection``).
    """
    if mirrors is None:
        return mi.Float(0.0)
    by_light = active & y.glossy_after_wide & has_wide_lobe(z.vertex)
    by_camera = active & z.glossy_after_wide & has_wide_lobe(y.vertex)
    a = dr.select(by_light, z.vertex.p, z.previous)
    b = dr.select(by_light, y.vertex.p, z.vertex.p)
    n = dr.select(by_light, y.vertex.n, z.vertex.n)
    d_vcm = dr.select(by_light, y.vertex.d_vcm / glossy, z.vertex.d_vcm)
    end = dr.select(by_light, y.previous, y.vertex.p)
    return _density_ratio(mirrors, a, b, n, d_vcm, end, by_light | by_camera)
