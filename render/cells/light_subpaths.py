"""Light subpaths of the cell sampler, each reduced to one vertex by resampling.

A light subpath scatters some twenty times, and each connection costs several ray casts, but the few
vertices close to the diffuser's inner face carry nearly all of the light. So one vertex per subpath
is drawn in proportion to a *target weight*: the light that it would send to a point of the coating,
directly and over the lower face, without visibility and with the medium ending at the inner face.
It stands for all of them (resampled importance sampling, ``render.sampling.reservoirs``). The
target weight is positive wherever a connection can be, so its errors cost time, not truth.

The drawn vertices are written to memory and connected afterwards to as many camera subpaths as look
at the same place (``render.cells.facet_paths``).
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from render.cells.fiber_light import FiberLight
from render.cells.lower_face_mirror import LowerFaceMirror
from render.geometry import fiber_poses
from render.paths.mirrors import KeptVertex
from render.paths.records import PackedRecords, allocated
from render.paths.vertex import (
    RATIO_MAX,
    PassableVertex,
    Vertex,
    channel_mean,
    extinction,
    has_wide_lobe,
    scattering_value,
)
from render.paths.walk import (
    GuidingDistribution,
    PassableState,
    begin_subpath,
    sample_scattering,
    trace_segment,
)
from render.sampling.proposals import LIGHT_EVENTS
from render.sampling.reservoirs import Reservoir
from render.sampling.streams import Stream
from render.scene import Scene

RESERVOIR_EVENT = LIGHT_EVENTS // 2
"""Events that one light subpath may take; the numbers that draw its vertex come after them."""
OPTICAL_DEPTH_MAX = 6.0
"""Where optical depths are cut in target weights.

Where the medium is not as thick as it seems, the target weight is at most this far off (e^-6), and
never 0.
"""
PARTIAL_REFLECTANCE = 0.1
"""What a rough face reflects below the critical angle, for target weights alone."""
TILT_COSINE = 0.3
"""Facets are tilted: added to the cosine at the untouched coating."""
ISOTROPIC_FRACTION = 0.03
"""Least target weight relative to isotropic scattering."""
GLOSSY_VALUE_MAX = 4.0
"""Most that a glossy vertex after one with a wide lobe scatters.

Its lobe's peak belongs to mirror connections.
"""


@dataclass
class DrawnVertex(KeptVertex):
    """The vertex that stands for a light subpath (a Dr.Jit PyTree).

    It is a ``PassableVertex`` where camera subpaths pass volumes. ``contribution`` is W and
    ``(o, d)`` the ray that the subpath began with.
    """

    contribution: mi.Float
    o: mi.Point3f
    d: mi.Vector3f


@dataclass
class DrawnVertices:
    """``paths`` drawn vertices per lane.

    Those of one path lie side by side; ``weight[node]`` is the weight of each at a direction node.
    """

    records: PackedRecords
    weight: list[mi.Float]
    lanes: mi.UInt32
    paths: int

    def index(self, path: mi.UInt32, lane: mi.UInt32) -> mi.UInt32:
        """Return where the vertex of ``path`` of ``lane`` is."""
        return path * self.lanes + lane

    def read(self, path: mi.UInt32, lane: mi.UInt32) -> DrawnVertex:
        """Return the vertex of ``path`` of ``lane``."""
        drawn: DrawnVertex = self.records.gather(self.index(path, lane))
        return drawn


class CoatingTarget:
    """Target weights of light vertices at one bend: knows where the diffuser ends."""

    def __init__(self, scene: Scene, bend: float, mirror: LowerFaceMirror) -> None:
        """Upload one plane per lit edge, the diffuser's inner face; ``bend`` in radians."""
        poses = fiber_poses(scene, bend)
        foot = poses.foot + poses.layer[:, None] * poses.face_inward
        planes: dict[tuple[float, ...], None] = {}
        for point, normal in zip(foot, poses.face_inward, strict=True):
            planes.setdefault((*np.round(normal, 6), float(np.round(point @ normal, 6))))
        self.planes = [mi.Float(list(plane)) for plane in planes]
        self.mirror = mirror
        # Total internal reflection begins at this squared cosine.
        self.critical = mi.Float(1.0 - scene.pad.index**-2.0)
        dr.make_opaque(self.planes, self.critical)

    def weight(
        self, y: Vertex, after_wide: mi.Bool, point: mi.Point3f, normal: mi.Vector3f,
        active: mi.Bool,
    ) -> mi.Float:  # fmt: skip
        """Return the target weight of ``y`` for a point of the coating; positive where active.

        ``after_wide`` says that the vertex before ``y`` is in a volume or diffuse; ``normal`` is
        the untouched coating's, into the pad.
        """
        total = self._direct(y, after_wide, point, normal, active)
        total += self._mirrored(y, point, normal, active)
        return dr.select(active, total, 0.0)

    def _direct(
        self, y: Vertex, after_wide: mi.Bool, point: mi.Point3f, normal: mi.Vector3f,
        active: mi.Bool,
    ) -> mi.Float:  # fmt: skip
        span = point - y.p
        squared = dr.maximum(dr.squared_norm(span), 1e-6)
        w = span * dr.rsqrt(squared)
        facing = dr.maximum(-dr.dot(normal, w), 0.0) + TILT_COSINE
        # Other vertices of the camera subpaths may see what the facets do not.
        sent = self._scattered(y, w, active)
        by_mirror = after_wide & ~has_wide_lobe(y)
        sent = dr.select(by_mirror, dr.minimum(sent, GLOSSY_VALUE_MAX), sent)
        sent = sent + ISOTROPIC_FRACTION * channel_mean(y.beta)
        return sent * facing / squared * self._transmittance(y, w, dr.sqrt(squared), active)

    def _mirrored(
        self, y: Vertex, point: mi.Point3f, normal: mi.Vector3f, active: mi.Bool
    ) -> mi.Float:
        active = active & has_wide_lobe(y)
        image, face = self.mirror.image(point, y.p)
        span = image - y.p
        squared = dr.maximum(dr.squared_norm(span), 1e-6)
        w = span * dr.rsqrt(squared)
        onto = dr.dot(w, face)
        reflected = w - 2.0 * onto * face
        facing = dr.maximum(-dr.dot(normal, reflected), 0.0) + TILT_COSINE
        reflectance = dr.select(dr.square(onto) < self.critical, 1.0, PARTIAL_REFLECTANCE)
        light = self._scattered(y, w, active) * facing * reflectance / squared
        return light * self._transmittance(y, w, dr.sqrt(squared), active)

    def _distance_inside(self, p: mi.Point3f, direction: mi.Vector3f) -> mi.Float:
        """Return the distance (mm) from ``p`` along ``direction`` to the diffuser's inner face."""
        longest = mi.Float(0.0)
        for plane in self.planes:
            x, y, z, level = (dr.gather(mi.Float, plane, mi.UInt32(i)) for i in range(4))
            normal = mi.Vector3f(x, y, z)
            depth = level - dr.dot(normal, p)
            cosine = dr.maximum(dr.dot(normal, direction), 1e-3)
            longest = dr.maximum(longest, depth / cosine)
        return longest

    def _transmittance(
        self, y: Vertex, w: mi.Vector3f, distance: mi.Float, active: mi.Bool
    ) -> mi.Float:
        sigma = channel_mean(extinction(y.medium, active & y.volume)[1])
        length = dr.minimum(self._distance_inside(y.p, w), distance)
        return dr.exp(-dr.minimum(sigma * length, OPTICAL_DEPTH_MAX))

    def _scattered(self, y: Vertex, w: mi.Vector3f, active: mi.Bool) -> mi.Float:
        return channel_mean(y.beta * scattering_value(y, w, mi.TransportMode.Importance, active))


def trace_light_subpaths(
    scene: mi.Scene, target: CoatingTarget, point: mi.Point3f, normal: mi.Vector3f,
    light: FiberLight, fiber: mi.UInt32, stream: Stream, paths: int,
    guiding: GuidingDistribution | None, passable: bool, lobed: bool,
) -> DrawnVertices:  # fmt: skip
    """Return drawn vertices for the ``point`` of the coating that each lane looks at.

    ``guiding`` is that of camera subpaths where they meet lamps and are joined to them, None where
    they do not; ``passable`` says that they pass volumes behind delta faces, ``lobed`` that the
    skin has a lobe beside Lambert's.
    """
    records = _trace(
        scene, target, point, normal, light, fiber, stream, paths, guiding, passable, lobed
    )
    dr.eval(records)
    lanes = dr.opaque(mi.UInt32, dr.width(fiber))
    lane = dr.arange(mi.UInt32, paths * dr.width(fiber)) % lanes
    of_node = light.weights(dr.gather(mi.UInt32, fiber, lane), records.o, records.d)
    weight = [value * records.contribution / paths for value in of_node]
    dr.eval(weight)
    return DrawnVertices(PackedRecords.of(records), weight, lanes, paths)


@dr.syntax
def _trace(
    scene: mi.Scene, target: CoatingTarget, point: mi.Point3f, normal: mi.Vector3f,
    light: FiberLight, fiber: mi.UInt32, stream: Stream, paths: int,
    guiding: GuidingDistribution | None, passable: bool, lobed: bool,
) -> DrawnVertex:  # fmt: skip
    """Trace and draw; one loop runs all light subpaths of a lane one after the other.

    That keeps SIMD lanes busy: sums of many path lengths differ less than single ones.
    """
    width = dr.width(fiber)
    lane = dr.arange(mi.UInt32, width)
    # What differs from run to run is data: compiled into the kernels, each would have its own.
    last, lanes = mi.UInt32(paths), mi.UInt32(width)
    dr.make_opaque(last, lanes)
    # --------------------------- Configure loop state ----------------------------
    path, event = mi.UInt32(0), mi.UInt32(0)  # which path, and where its stream of numbers is
    o, d = dr.zeros(mi.Point3f), mi.Vector3f(0, 0, 1)  # the ray that the path began with
    state = begin_subpath(
        o, d, dr.zeros(mi.MediumPtr), mi.Spectrum(1.0), mi.Float(0), mi.Float(0), mi.Float(0.5)
    )
    none = KeptVertex.none()
    if passable:
        state = PassableState.of(state)
        none.vertex = PassableVertex.of(none.vertex)
    before, before_wide = dr.zeros(mi.Point3f), mi.Bool(False)  # the last vertex, and its lobe
    drawn = Reservoir.holding(none)
    records = allocated(
        DrawnVertex(**vars(none), contribution=mi.Float(0), o=o, d=d), width * paths
    )
    fresh = dr.full(mi.Bool, True, width)  # lanes that begin a path
    first = mi.Bool(fresh)  # lanes whose path has no vertex yet
    from_volume = mi.Bool(False)  # lanes whose last vertex is in a volume
    active = mi.Bool(fresh)
    while active:
        if fresh:
            pick_node, u, v_angle, free = stream.event(path * LIGHT_EVENTS)
            x, y, _, _ = stream.event(path * LIGHT_EVENTS + 1)
            # The paths of a lane divide the direction nodes among themselves.
            stratum = (mi.Float(path) + pick_node) / mi.Float(last)
            o, d = light.sample(fiber, stratum, (u, v_angle), mi.Point2f(x, y))
            # Eq. 32: camera subpaths may meet the lamp. Otherwise both sums start at 0.
            d_vc = mi.Float(0.0)
            if guiding is not None:
                emitted = light.ray(fiber, o, d).emitted
                d_vc = dr.select(emitted > 0, dr.rcp(emitted), 0.0)
            state = begin_subpath(
                o, d, light.medium(scene, fiber), mi.Spectrum(1.0), mi.Float(0), d_vc, free
            )
            if passable:
                state = PassableState.of(state)
            event = path * LIGHT_EVENTS + 2
            before_wide = mi.Bool(False)
            drawn.total = mi.Float(0.0)
            first, from_volume = mi.Bool(True), mi.Bool(False)
        state, v, arrived, escaped = trace_segment(scene, state, active)
        if guiding is not None:
            # Eq. 31, at the first vertex: camera subpaths that end there are joined to the lamp.
            if arrived & first:
                through = channel_mean(dr.exp(-state.depth))
                v.d_vcm = v.d_vc * light.ray(fiber, v.p, d).joined / through
            first = first & ~arrived
            # Camera subpaths that come by go on as they are guided. Whatever the direction that
            # they come from, a diffuse surface sends as many of them towards its predecessor; with
            # a lobe that depends on it, and each strategy asks by itself.
            if not lobed:  # noqa: SIM102 (the other one is traced)
                if arrived & v.diffuse:
                    unguided = dr.maximum(dr.dot(v.n, v.wi), 1e-6) / dr.pi
                    v.d_vc = dr.minimum(
                        v.d_vc * guiding.mixture_pdf(v, v.wi, unguided) / unguided, RATIO_MAX
                    )
        else:
            v.terminal = v.terminal | v.diffuse
        if not passable:
            # Camera subpaths never end in a volume: no strategy competes for it here.
            v.d_vcm = dr.select(v.volume, 0.0, v.d_vcm)
            v.d_vc = dr.select(v.volume | (from_volume & ~v.delta), 0.0, v.d_vc)
        # --------------------- Draw the vertex, or keep another one ---------------
        weight = target.weight(v, before_wide, point, normal, arrived & ~v.delta)
        here = KeptVertex(v, before, before_wide & ~has_wide_lobe(v))
        drawn = drawn.update(here, weight, stream.event(event + RESERVOIR_EVENT)[0])
        before = dr.select(arrived, v.p, before)
        before_wide = dr.select(arrived, arrived & has_wide_lobe(v), before_wide)
        # --------------------------- Scatter, or end the path ---------------------
        from_volume = dr.select(arrived, v.volume, from_volume)
        state, alive = sample_scattering(
            state,
            v,
            mi.TransportMode.Importance,
            stream.event(event),
            arrived,
            returning=guiding if lobed else None,
        )
        event += 1
        cut = event >= path * LIGHT_EVENTS + RESERVOIR_EVENT
        fresh = active & (escaped | (arrived & ~alive) | cut)
        record = DrawnVertex(**vars(drawn.item), contribution=drawn.contribution_weight(), o=o, d=d)
        # Dr.Jit's own local memory (1.5) does not compile masks on LLVM. Records must be written
        # under a mask argument, outside of a traced ``if``.
        dr.scatter(records, record, path * lanes + lane, fresh)
        path += dr.select(fresh, 1, 0)
        active = active & (path < last)
    return records
