"""Directions from the coating at a fiber end, as it is seen through the faces of a flat pad.

On a clear pad most light of a facet comes straight from the lamp: refracted once at the outer face,
perhaps reflected before in the lower face or in walls. Where the faces are smooth no connection
finds these ways, and a cosine-distributed direction meets a lamp of half a millimeter once in a
thousand times. So a direction is aimed at the lamp: unfolded over the mirrors (image method) and
bent by Snell's law at the outer face, drawn from a heavy-tailed lobe as wide as the lamp and the
roughness of the face make it. The lobe is a guide: what it misses other directions find,
with the density of all of them together in the MIS weights.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi
import numpy as np

from render.arrays import Array
from render.cells.crossings import face_crossing
from render.cells.lower_face_mirror import LowerFaceMirror
from render.geometry import LOWER, flat_fiber_poses
from render.paths.reflection_lobe import ReflectionLobe
from render.paths.vertex import Vertex
from render.scene import Scene

LOBE_RADIUS = 0.7
"""Scale of the lobe at the lamp, in units of the lamp's radius."""
MIN_WIDTH = 5e-4
"""Least width of a lobe, rad: float32 resolves directions to 1e-7."""
GRAZING_COSINE = 0.05
"""Least cosine of refraction in widths: they vanish where light leaves along the face."""
NEWTON_STEPS = 4


@dataclass(frozen=True)
class Way:
    """How light comes from the lamp, and the ``share`` of the directions that aim so.

    Reflected in a ``wall`` beside it (-1, 1: which; 0: none), in the ``opposite`` one (-1: before
    and behind a lamp below the pad) or in the lower face (``mirrored``), or through the lower face
    from ``below``.
    """

    share: float
    wall: int = 0
    opposite: int = 0
    mirrored: bool = False
    below: bool = False


class LampAim:
    """Aimed directions on one flat pad.

    ``main_ways`` are those of most light, straight and over the lower face.
    """

    def __init__(self, scene: Scene, mirror: LowerFaceMirror) -> None:
        """Upload the lamps."""
        poses = flat_fiber_poses(scene)
        # Lamps in the silicone are seen where they are.
        inside, foot = poses.inside, np.where(poses.inside[:, None], poses.position, poses.foot)
        from_below = (poses.face == LOWER) & ~inside
        # Planes of the walls beside a lamp and of those before and behind it.
        normals, offsets = _walls(scene, foot)
        self.walls = mi.Float(np.column_stack([offsets, from_below]).astype(np.float32).ravel())
        self.wall_normals = mi.Float(normals.astype(np.float32).ravel())
        self.mirror = mirror
        ends = poses.position[:, 2] - poses.radius
        lowest = ends[~from_below & ~inside].min(initial=np.inf)
        ways, both = [Way(0.4), Way(0.3, mirrored=True)], (False, True)
        sides = (-1, 1) if (from_below | inside).any() else (1,)
        ways += [Way(0.05, wall=w, mirrored=m) for w in (-1, 1) for m in both]
        ways += [Way(0.02, w, s, mirrored=m) for s in sides for w in (-1, 0, 1) for m in both]
        if lowest < scene.box.low[2]:
            ways.append(Way(0.2, below=True))
        total = sum(way.share for way in ways)
        self.ways = [replace(way, share=way.share / total) for way in ways]
        self.inside = mi.Bool(inside) if inside.any() else None
        frames = np.stack([foot, poses.face_inward, poses.position], axis=1)
        self.frames = mi.Float(frames.astype(np.float32).ravel())
        slope = np.array([finish.roughness for finish in scene.finishes]) / np.sqrt(2.0)
        self.radius = mi.Float(poses.radius.astype(np.float32))
        # Of the faces that the lamps shine through, and of the lower one.
        self.slope = mi.Float(slope[poses.face].astype(np.float32))
        self.constants = mi.Float([slope[LOWER], scene.box.low[2]])
        self.main_ways = self.ways[:2]
        self.index = mi.Float(scene.pad.index)
        dr.make_opaque(
            self.frames, self.walls, self.wall_normals, self.radius, self.slope, self.constants,
            self.index, self.inside,
        )  # fmt: skip

    def sample(
        self, fiber: mi.UInt32, v: Vertex, pick: mi.Float, x: mi.Float, y: mi.Float
    ) -> mi.Vector3f:
        """Return directions from ``v`` at the end of ``fiber``; ``pick`` draws the way."""
        wall, opposite = mi.Float(0.0), mi.Float(0.0)
        mirrored, below = mi.Bool(False), mi.Bool(False)
        total = 0.0
        for way in self.ways:
            chosen = pick >= total
            wall = dr.select(chosen, float(way.wall), wall)
            opposite = dr.select(chosen, float(way.opposite), opposite)
            mirrored = dr.select(chosen, way.mirrored, mirrored)
            below = dr.select(chosen, way.below, below)
            total += way.share
        lobe, unfold = self._lobe(fiber, v.p, wall, opposite, mirrored, below)
        return unfold.back(lobe.sample(x, y))

    def density(self, fiber: mi.UInt32, v: Vertex, direction: mi.Vector3f) -> mi.Float:
        """Return the density per solid angle with which ``sample`` finds ``direction``."""
        total = mi.Float(0.0)
        for way in self.ways:
            total += way.share * self.way_density(fiber, v.p, way, direction)
        return total

    def sample_way(
        self, fiber: mi.UInt32, a: mi.Point3f, way: Way, x: mi.Float, y: mi.Float
    ) -> mi.Vector3f:
        """Return directions of one way."""
        lobe, unfold = self._lobe_of(fiber, a, way)
        return unfold.back(lobe.sample(x, y))

    def way_density(
        self, fiber: mi.UInt32, a: mi.Point3f, way: Way, direction: mi.Vector3f
    ) -> mi.Float:
        """Return the density per solid angle with which ``sample_way`` finds ``direction``."""
        lobe, unfold = self._lobe_of(fiber, a, way)
        return lobe.density(unfold(direction))

    def _lobe_of(self, fiber: mi.UInt32, a: mi.Point3f, way: Way) -> tuple[ReflectionLobe, _Unfold]:
        return self._lobe(
            fiber, a, mi.Float(way.wall), mi.Float(way.opposite), mi.Bool(way.mirrored),
            mi.Bool(way.below),
        )  # fmt: skip

    def _lobe(
        self, fiber: mi.UInt32, a: mi.Point3f, wall: mi.Float, opposite: mi.Float,
        mirrored: mi.Bool, below: mi.Bool,
    ) -> tuple[ReflectionLobe, _Unfold]:  # fmt: skip
        """Return the lobe about the lamp as seen from the unfolded ``a``, and the unfolding."""
        foot, inward, lamp = (dr.gather(mi.Vector3f, self.frames, 3 * fiber + i) for i in range(3))
        radius = dr.gather(mi.Float, self.radius, fiber)
        lower, level = (dr.gather(mi.Float, self.constants, mi.UInt32(i)) for i in range(2))
        slope = dr.select(below, lower, dr.gather(mi.Float, self.slope, fiber))
        # What comes in through the lower face has not been reflected by it.
        mirrored &= dr.gather(mi.Float, self.walls, 5 * fiber + 4) == 0.0
        # Through the lower face: what of the lamp is below the pad.
        up = mi.Vector3f(0.0, 0.0, 1.0)
        foot = dr.select(below, mi.Vector3f(lamp.x, lamp.y, level), foot)
        inward = dr.select(below, up, inward)
        lamp.z = dr.select(below, dr.minimum(lamp.z, level - 0.5 * radius), lamp.z)
        # ------------------------- Image of the point ----------------------------------
        beside, by_wall = dr.select(wall > 0, mi.UInt32(1), 0), wall != 0
        along = dr.gather(mi.Vector3f, self.wall_normals, 4 * fiber + beside)
        end = dr.gather(mi.Float, self.walls, 5 * fiber + beside)
        aside = 2.0 * (end - dr.dot(mi.Vector3f(a) - foot, along))
        seen = a + dr.select(by_wall, aside, 0.0) * along
        ahead_of, by_far = dr.select(opposite > 0, mi.UInt32(3), 2), opposite != 0
        far_axis = dr.gather(mi.Vector3f, self.wall_normals, 4 * fiber + ahead_of)
        far = dr.gather(mi.Float, self.walls, 5 * fiber + ahead_of)
        ahead = 2.0 * (far - dr.dot(mi.Vector3f(seen) - foot, far_axis))
        seen += dr.select(by_far, ahead, 0.0) * far_axis
        image, normal = self.mirror.image(seen, mi.Point3f(foot))
        seen = dr.select(mirrored, image, seen)
        unfold = _Unfold([(along, by_wall), (far_axis, by_far), (normal, mirrored)])
        # ------------------------- Snell's law at the face -----------------------------
        blur = dr.select(mirrored, 1.4 * lower, 0.0)
        index = self.index
        way = self._way_to(fiber, seen, foot, inward, lamp)
        axis = way.axis
        inside, outside, before, after = way.inside, way.outside, way.before, way.after
        # ------------------------- Widths ----------------------------------------------
        cos_in, cos_out = inside / before, dr.maximum(outside / after, GRAZING_COSINE)
        if self.inside is not None:
            cos_out = dr.select(dr.gather(mi.Bool, self.inside, fiber), 1.0, cos_out)
        # What the lamp's plane moves by per angle, in and across the plane of incidence.
        moved_in = before * cos_out / cos_in + after * index * cos_in / cos_out
        moved_across = before + after * index
        size = _size(radius, slope, index, after)
        wide, narrow = (dr.hypot(size / moved, blur) for moved in (moved_in, moved_across))
        sideways = dr.cross(axis, inward)
        other = dr.select(dr.abs(inward.x) > 0.9, mi.Vector3f(0, 1, 0), mi.Vector3f(1, 0, 0))
        sideways = dr.select(dr.squared_norm(sideways) > 1e-8, dr.normalize(sideways), other)
        return _lobe(axis, dr.normalize(dr.cross(sideways, axis)), wide, narrow), unfold

    def _way_to(
        self, fiber: mi.UInt32, seen: mi.Point3f, foot: mi.Vector3f, inward: mi.Vector3f,
        lamp: mi.Vector3f,
    ) -> _Refracted:  # fmt: skip
        """Return the way to a lamp before a face, or straight to one in the silicone."""
        way = _refracted(seen, foot, inward, lamp, self.index)
        if self.inside is None:
            return way
        span = lamp - mi.Vector3f(seen)
        length = dr.maximum(dr.norm(span), 1e-3)
        straight = _Refracted(span / length, length, mi.Float(0.0), length, mi.Float(0.0))
        return dr.select(dr.gather(mi.Bool, self.inside, fiber), straight, way)


def _size(radius: mi.Float, slope: mi.Float, index: mi.Float, after: mi.Float) -> mi.Float:
    """Return how large (mm) a lamp looks ``after`` mm behind a face of that ``slope``."""
    rough = 2.0 * (index - 1.0) * slope * after
    return dr.sqrt(dr.square(LOBE_RADIUS * radius) + dr.square(rough))


def _lobe(
    axis: mi.Vector3f, ahead: mi.Vector3f, wide: mi.Float, narrow: mi.Float
) -> ReflectionLobe:
    """Return a lobe of `MIN_WIDTH` at least."""
    return ReflectionLobe(
        axis, ahead, dr.cross(axis, ahead),
        dr.maximum(wide, MIN_WIDTH), dr.maximum(narrow, MIN_WIDTH),
    )  # fmt: skip


@dataclass
class _Refracted:
    """The way from a point to a lamp by Snell's law at the face before the lamp.

    ``inside`` and ``outside`` are the distances of both from the face, ``before`` and ``after`` the
    lengths of the way there.
    """

    axis: mi.Vector3f
    inside: mi.Float
    outside: mi.Float
    before: mi.Float
    after: mi.Float


def _refracted(
    seen: mi.Point3f, foot: mi.Vector3f, inward: mi.Vector3f, lamp: mi.Vector3f, index: mi.Float
) -> _Refracted:
    inside = dr.maximum(dr.dot(mi.Vector3f(seen) - foot, inward), 1e-3)
    outside = dr.maximum(-dr.dot(lamp - foot, inward), 1e-4)
    across = lamp - mi.Vector3f(seen)
    across -= dr.dot(across, inward) * inward
    reach = dr.norm(across)
    across = across / dr.maximum(reach, 1e-6)
    # An aim need not be exact, only the same every time.
    critical = inside * dr.rsqrt(dr.maximum(dr.square(index) - 1.0, 1e-6))
    lateral = face_crossing(reach, inside, outside, index, critical, NEWTON_STEPS)
    before, after = dr.hypot(lateral, inside), dr.hypot(reach - lateral, outside)
    axis = (lateral * across - inside * inward) / before
    return _Refracted(axis, inside, outside, before, after)


def _walls(scene: Scene, foot: Array) -> tuple[Array, Array]:
    """Return the planes of the walls about each lamp: normals ``(fiber, 4, 3)`` and offsets.

    The first two lie beside the lamp, down and up its face, the others before and behind it, all
    normals as the lamp's axes are. The offsets ``(fiber, 4)``, mm, are from ``foot`` along them.
    """
    flat = flat_fiber_poses(scene)
    far_axis = np.where((flat.face == LOWER)[:, None], flat.face_up, flat.face_inward)
    normals = np.stack([flat.face_along] * 2 + [far_axis] * 2, axis=1)
    low, high = scene.box.low * [1, 1, 0], scene.box.high * [1, 1, 0]
    corners = np.einsum("fwk,ck->fwc", normals, np.stack([low, high]))
    lower = np.array([True, False, True, False])
    place = np.where(lower, corners.min(axis=-1), corners.max(axis=-1))
    points = place[..., None] * normals
    return normals, np.einsum("fwk,fwk->fw", points - foot[:, None], normals)


@dataclass
class _Unfold:
    """Reflects directions in the mirrors of a way, as it meets them (normal, whether it has it)."""

    mirrors: list[tuple[mi.Vector3f, mi.Bool]]

    def __call__(self, direction: mi.Vector3f) -> mi.Vector3f:
        """Return directions as they are behind all mirrors."""
        return self._reflected(direction, self.mirrors)

    def back(self, direction: mi.Vector3f) -> mi.Vector3f:
        """Return directions as they were before."""
        return self._reflected(direction, self.mirrors[::-1])

    def _reflected(
        self, direction: mi.Vector3f, mirrors: list[tuple[mi.Vector3f, mi.Bool]]
    ) -> mi.Vector3f:
        for normal, applies in mirrors:
            onto = 2.0 * dr.dot(direction, normal) * normal
            direction = direction - dr.select(applies, onto, 0.0)
        return direction
