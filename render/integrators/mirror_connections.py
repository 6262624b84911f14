"""Bridging camera and light vertices over one reflection in any flat glossy face of a scene.

Joining to a vertex on a glossy face mostly misses its narrow lobe. A bridge instead mirrors the
light vertex in the face's plane, draws a direction from the camera vertex close to the mirror
image, as wide as the roughness makes the reflection, and lets it find the face (as
``render.cells.lower_face_mirror`` does for the one face of a pad). It competes, by the balance
heuristic, for the paths

    ... - y (volume or diffuse) - b (glossy, in a known plane) - a (volume or diffuse) - ...

wherever such a triple lies on the path, with ``y`` on the light and ``a`` on the camera subpath.
Then the recursive sums need one factor, ``counted``, at vertices that end a triple.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from render.integrators.path_limits import GLOSSY
from render.integrators.planar_mirrors import BINS, CLOSE, Mirror, mirrors
from render.paths.connect import cast, optical_depth
from render.paths.reflection_lobe import AimLobe
from render.paths.vertex import RATIO_MAX, Vertex, area_factor, extinction, is_smooth, scatter

# A mirror whose faces the straight reflection misses by this share of its way is half as likely.
MISS = 0.1
# Distance, relative to the mirrors' extent, up to which a first look does not tell ways over them
# apart by their length.
BLUR = 0.05


class Mirrors:
    """The mirrors of a scene, and the densities of bridges over them."""

    def __init__(self, found: list[Mirror]) -> None:
        """Upload ``found``, of which there is at least one."""
        low = np.min([m.low for m in found], axis=0)
        size = float((np.max([m.high for m in found], axis=0) - low).max())
        self.count = len(found)
        rows = [
            (*m.normal, m.offset, *(0.5 * (m.low + m.high)), *(0.5 * (m.high - m.low)), m.slope)
            for m in found
        ]
        self.columns = [mi.Float(column.astype(np.float32)) for column in np.array(rows).T]
        self.close = mi.Float(CLOSE * size)
        self.blur = mi.Float((BLUR * size) ** 2)
        table = np.concatenate([m.reflectance.ravel() for m in found])
        self.reflectance = mi.Float(table.astype(np.float32))
        dr.make_opaque(self.columns, self.close, self.blur, self.reflectance)

    @staticmethod
    def of(scene: Any) -> Mirrors | None:
        """Return the mirrors of a Mitsuba scene; None where there are none to bridge over."""
        found = mirrors(scene)
        return Mirrors(found) if found else None

    def _numbers(self, k: Any, first: int, count: int) -> list[Any]:
        return [dr.gather(mi.Float, column, k) for column in self.columns[first : first + count]]

    def _height(self, k: Any, p: Any) -> Any:
        x, y, z, offset = self._numbers(k, 0, 4)
        return x * p.x + y * p.y + z * p.z - offset

    def _liking(self, k: Any, a: Any, y: Any) -> Any:
        """Return how likely a bridge from ``a`` to ``y`` uses mirror ``k``, not normalized."""
        height_a, height_y = self._height(k, a), self._height(k, y)
        normal = mi.Vector3f(*self._numbers(k, 0, 3))
        way = y - 2.0 * height_y * normal - a
        squared = dr.maximum(dr.squared_norm(way), dr.square(self.close))
        share = dr.abs(height_a) / dr.maximum(dr.abs(height_a) + dr.abs(height_y), 1e-20)
        beside = dr.abs(a + share * way - mi.Point3f(*self._numbers(k, 4, 3)))
        beside = dr.maximum(beside - mi.Vector3f(*self._numbers(k, 7, 3)), 0.0)
        missed = dr.squared_norm(beside) / (squared * MISS * MISS)
        # A vertex in the mirror's own plane has no reflection there.
        apart = dr.minimum(dr.abs(height_a), dr.abs(height_y)) > self.close
        fits = apart & (height_a * height_y > 0)
        cosine = (dr.abs(height_a) + dr.abs(height_y)) * dr.rsqrt(squared)
        step = dr.minimum(mi.UInt32(cosine * BINS), BINS - 1)
        row = 2 * k + dr.select(height_a > 0, mi.UInt32(1), 0)
        reflected = dr.gather(mi.Float, self.reflectance, row * BINS + step)
        return dr.select(fits, reflected / (squared * (1.0 + missed)), 0.0)

    def _likings(self, a: Any, y: Any) -> tuple[list[Any], Any]:
        each = [self._liking(mi.UInt32(k), a, y) for k in range(self.count)]
        return each, sum(each[1:], each[0])

    def _lobe(self, k: Any, a: Any, y: Any) -> AimLobe:
        normal = mi.Vector3f(*self._numbers(k, 0, 3))
        height_a, height_y = self._height(k, a), self._height(k, y)
        (slope,) = self._numbers(k, 10, 1)
        image = y - 2.0 * height_y * normal
        return AimLobe.towards(a, image, normal, dr.abs(height_a), dr.abs(height_y), slope)

    def plane(self, p: Any, normal: Any) -> Any:
        """Return the number of the mirror that a surface point lies in; ``count`` for none."""
        found: Any = mi.UInt32(self.count)
        for i in reversed(range(self.count)):
            k = mi.UInt32(i)
            facing = dr.abs(dr.dot(mi.Vector3f(*self._numbers(k, 0, 3)), mi.Vector3f(normal)))
            inside = (facing > 1.0 - 1e-5) & (dr.abs(self._height(k, p)) < self.close)
            found = dr.select(inside, k, found)
        return found

    def drawn(self, a: Any, y: Any, pick: Any) -> tuple[Any, Any]:
        """Return a mirror, drawn by ``pick``, and the probability of that; 0 where none fits."""
        each, total = self._likings(a, y)
        k: Any = mi.UInt32(0)
        chosen, below = each[0], each[0]
        for i in range(1, self.count):
            beyond = (pick * total >= below) & (each[i] > 0)
            k = dr.select(beyond, mi.UInt32(i), k)
            chosen = dr.select(beyond, each[i], chosen)
            below = below + each[i]
        return k, dr.select(total > 0, chosen / dr.maximum(total, 1e-30), 0.0)

    def image(self, k: Any, a: Any, y: Any) -> tuple[Any, Any, Any]:
        """Return the normal of mirror ``k``, the image of ``a`` in it, and its liking for both."""
        normal = mi.Vector3f(*self._numbers(k, 0, 3))
        return normal, a - 2.0 * self._height(k, a) * normal, self._liking(k, a, y)

    def aimed(self, k: Any, a: Any, y: Any, u: Any, v: Any) -> tuple[Any, Any]:
        """Return a direction from ``a`` to mirror ``k``, and its density per solid angle."""
        lobe = self._lobe(k, a, y)
        direction = lobe.sample(u, v)
        return direction, lobe.density(direction)

    def area_density(self, a: Any, b: Any, normal: Any, y: Any) -> Any:
        """Return the density per area with which a bridge from ``a`` to ``y`` finds ``b``.

        ``normal`` is the surface's at ``b``; 0 where ``b`` is in no mirror.
        """
        k = self.plane(b, normal)
        known = k < self.count
        k = dr.minimum(k, self.count - 1)
        _, total = self._likings(a, y)
        share = self._liking(k, a, y) / dr.maximum(total, 1e-30)
        span = b - a
        squared = dr.maximum(dr.squared_norm(span), 1e-12)
        direction = span * dr.rsqrt(squared)
        cosine = dr.abs(dr.dot(normal, direction))
        density = self._lobe(k, a, y).density(direction) * share * cosine / squared
        return dr.select(known & (share > 0), density, 0.0)


@dataclass
class Trail:
    """The last vertices of a subpath, for the triples that they end (a Dr.Jit PyTree).

    ``p``, ``n``, ``vcm`` and ``smooth`` (in a volume, or diffuse) are the last vertex's, ``before``
    is the point of the one before it; ``waiting`` says that the last is glossy after a smooth one.
    """

    p: Any
    n: Any
    vcm: Any
    smooth: Any
    before: Any
    waiting: Any

    @staticmethod
    def empty() -> Trail:
        """Return the trail of a subpath that has only its end on a lens or an emitter."""
        return Trail(
            dr.zeros(mi.Point3f), dr.zeros(mi.Normal3f), mi.Float(0.0), mi.Bool(False),
            dr.zeros(mi.Point3f), mi.Bool(False),
        )  # fmt: skip

    def then(self, v: Vertex, arrived: Any) -> Trail:
        """Return the trail with vertex ``v``, where the subpath ``arrived`` at one."""
        smooth = is_smooth(v)
        fields = Trail(v.p, v.n, v.vcm, smooth, self.p, ~smooth & ~v.delta & self.smooth)
        return fields.where(arrived, self)

    def where(self, condition: Any, other: Trail) -> Trail:
        """Return this trail where ``condition`` holds, else ``other``."""
        return Trail(
            **{k: dr.select(condition, getattr(self, k), getattr(other, k)) for k in vars(self)}
        )


@dr.syntax
def ratio(mirrors: Mirrors, a: Any, b: Any, n: Any, vcm: Any, y: Any, active: Any) -> Any:
    """Return the density of bridges from ``a`` to ``y`` over that of the subpath that found ``b``.

    ``n`` and ``vcm`` are those of the glossy vertex at ``b``.
    """
    result = mi.Float(0.0)
    if active:
        result = dr.minimum(vcm * mirrors.area_density(a, b, n, y), RATIO_MAX)
    return result


def counted(
    mirrors: Mirrors | None, v: Vertex, trail: Trail, active: Any, from_camera: bool, first: Any
) -> Any:
    """Return ``vcm`` of ``v`` with what joins of its edge count, and the bridges over its triple.

    ``trail`` ends before ``v``, which is the ``first`` vertex of the subpath or not.
    """
    lobe, light = (~trail.smooth, is_smooth(v)) if from_camera else (~is_smooth(v), trail.smooth)
    fair = dr.select(lobe & light & ~first, GLOSSY, 1.0)
    if mirrors is None:
        return v.vcm * fair
    ends = active & trail.waiting & is_smooth(v)
    a, y = (trail.before, v.p) if from_camera else (v.p, trail.before)
    further = ratio(mirrors, a, trail.p, trail.n, trail.vcm, y, ends)
    return dr.minimum(v.vcm * (fair + further), RATIO_MAX)


def competing(
    mirrors: Mirrors | None, y: Vertex, trail: Trail, z: Vertex, before: Any, waiting: Any,
    active: Any,
) -> Any:  # fmt: skip
    """Return the density of bridges relative to joining light vertex ``y`` to camera vertex ``z``.

    ``trail`` ends at ``y``; ``before`` is the point before ``z``, which is glossy after a smooth
    vertex where ``waiting``.
    """
    if mirrors is None:
        return mi.Float(0.0)
    by_light = active & trail.waiting & is_smooth(z)
    by_camera = active & waiting & is_smooth(y)
    a = dr.select(by_light, z.p, before)
    b = dr.select(by_light, y.p, z.p)
    n = dr.select(by_light, y.n, z.n)
    vcm = dr.select(by_light, y.vcm / GLOSSY, z.vcm)
    end = dr.select(by_light, trail.before, y.p)
    return ratio(mirrors, a, b, n, vcm, end, by_light | by_camera)


@dr.syntax
def bridge(
    scene: Any, mirrors: Mirrors, y: Vertex, a: Vertex, k: Any, chance: Any,
    numbers: tuple[Any, Any], active: Any,
) -> Any:  # fmt: skip
    """Return the MIS-weighted light that camera vertex ``a`` gets from ``y`` over mirror ``k``.

    Both are in volumes or diffuse; the mirror was drawn with probability ``chance``, and that is
    divided by. Strategies that find ``b`` from either side compete.
    """
    active = active & (y.weight > 0) & (a.weight > 0) & (chance > 0)
    direction, density = mirrors.aimed(k, a.p, y.p, *numbers)
    density *= chance
    active = active & (density > 0)
    f_a, p_a, r_a = scatter(a, direction, mi.TransportMode.Radiance, active)
    active = active & (dr.max(f_a) > 0)
    b, depth_ab, hit = cast(scene, a, direction, active)
    active = hit & ~b.diffuse & ~b.delta & (mirrors.plane(b.p, b.n) == k)
    span = b.p - y.p
    squared = dr.squared_norm(span)
    w = span * dr.rsqrt(squared)
    f_y, p_y, r_y = scatter(y, w, mi.TransportMode.Importance, active)
    f_b, p_b, r_b = scatter(b, -w, mi.TransportMode.Radiance, active)
    value = y.beta * f_y * f_b * f_a * a.beta / (squared * density)
    active = active & (dr.max(value) > 0) & (squared > 0)
    depth_by, clear = optical_depth(scene, y, b, active)
    t_ab, t_by = dr.exp(-depth_ab), dr.exp(-depth_by)
    mean_ab, mean_by = dr.mean(t_ab), dr.mean(t_by)
    _, sigma_y = extinction(y.medium, active & y.volume)
    _, sigma_a = extinction(a.medium, active & a.volume)
    reach_y = dr.select(y.volume, dr.mean(sigma_y * t_by), mean_by)
    reach_a = dr.select(a.volume, dr.mean(sigma_a * t_ab), mean_ab)
    apart = dr.squared_norm(b.p - a.p)
    # The camera finds b from a; then light is joined to b, or the camera goes on to y.
    camera_b = dr.select(a.terminal, 0.0, p_a * mean_ab / density)
    r_y = dr.select(y.terminal, 0.0, r_y)
    camera_y = p_b * area_factor(y, w) * reach_y / squared * (y.vcm + y.vc * r_y)
    # Light finds b from y; then it is joined to a, or goes on to a.
    here = density * area_factor(b, direction) / apart
    light_b = p_y * area_factor(b, w) * mean_by / squared / here
    light_a = r_b * area_factor(a, direction) * reach_a / apart * (a.vcm + a.vc * r_a)
    mis = 1.0 / (1.0 + camera_b * (GLOSSY + camera_y) + light_b * (1.0 + light_a))
    return dr.select(clear & active, value * t_ab * t_by * mis * y.weight * a.weight, 0.0)
