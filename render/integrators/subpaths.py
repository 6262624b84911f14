"""Bidirectional paths between the emitters of any scene and the pixels of a film: both subpaths.

All strategies (s light vertices, t camera vertices) are combined by the balance heuristic with
recursive sums (Georgiev 2012, "Implementing vertex connection and merging"): emitters that a camera
subpath meets (s = 0), direct light (s = 1), connections of light and camera vertices (s, t >= 2),
mirror connections over flat glossy faces (``render.integrators.mirror_connections``), and light
vertices connected to the camera (t = 1). No path is ever stored: of each subpath a few vertices are
kept, drawn by reservoirs.

Long scattering belongs to light subpaths. Camera subpaths pass two vertices in volumes, so that two
vertices that happen to be close make a connection bright only if the camera's own last ones were
close as well. They are absorbed at the third one, and behind a diffuse surface at the first. A
specular face, at which nothing can be connected, lets them pass two again: of light that is
scattered once between two such faces only camera subpaths know.

Strategies need not count alike in the balance heuristic: noisy ones whose light others find as well
count less (``render.integrators.mirror_connections.GLOSSY_WEIGHT``,
``render.integrators.film_sampler.PROJECTION_WEIGHT``).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import drjit as dr
import mitsuba as mi

from render.errors import RenderError
from render.integrators.emitters import Emission
from render.integrators.mirror_connections import MirrorSet, connection_weight
from render.paths.connect import density_at, optical_depth, strategies_before
from render.paths.mirrors import KeptVertex, SubpathTail, shared_d_vcm
from render.paths.vertex import (
    VOLUME_PASSES,
    PassableVertex,
    Vertex,
    channel_mean,
    empty_vertex,
    evaluate_scattering,
    has_wide_lobe,
    passes_behind,
    scattering_value,
)
from render.paths.walk import (
    PassableState,
    begin_subpath,
    in_vacuum,
    sample_scattering,
    trace_segment,
)
from render.sampling.reservoirs import Reservoir
from render.sampling.streams import Stream

EVENT_BLOCK = 2048
"""Further events of the same vertex are so far apart: direct light and reservoirs draw there."""
EVENTS_MAX = 2000
"""Events that one subpath may take, null boundaries included."""
LATER_WEIGHT = 0.5
"""Selection weight of the start of mirror connections at a wide vertex behind another one."""
SEEN_GLOSSY_WEIGHT = 0.3
"""Selection weight of the glossy vertex that the lens sees, relative to one behind it."""


@dataclass(frozen=True)
class PathLimits:
    """``max_depth`` edges per path (-1: no limit); Russian roulette from ``rr_depth`` on."""

    max_depth: int = -1
    rr_depth: int = 5

    def __post_init__(self) -> None:
        """Check the ranges.

        Raises:
            RenderError: names the parameter that is out of range.
        """
        if self.max_depth < 1 and self.max_depth != -1:
            raise RenderError(
                f"max_depth = {self.max_depth}, allowed: at least 1 edge, or -1 for no limit",
                field="max_depth",
            )
        if self.rr_depth < 1:
            raise RenderError(f"rr_depth = {self.rr_depth}, allowed: at least 1", field="rr_depth")

    def edges(self) -> mi.UInt32:
        """Return the greatest number of edges as an opaque integer."""
        value = mi.UInt32(self.max_depth if self.max_depth >= 0 else 1 << 30)
        dr.make_opaque(value)
        return value

    def roulette(self) -> mi.UInt32:
        """Return the first edge with Russian roulette as an opaque integer."""
        value = mi.UInt32(self.rr_depth)
        dr.make_opaque(value)
        return value


def roulette_weight(
    beta: mi.Spectrum, edges: mi.UInt32, first: mi.UInt32, number: mi.Float
) -> mi.Float:
    """Return the weight of Russian roulette from edge ``first`` on: 0 where the path ends."""
    survival = dr.clip(dr.max(beta), 0.05, 0.99)
    survival = dr.select(edges >= first, survival, 1.0)
    return dr.select(number < survival, dr.rcp(survival), 0.0)


# -- camera subpaths ---------------------------------------------------------------------------


@dataclass
class CameraVertex(KeptVertex):
    """A camera vertex for connections, behind ``edges`` edges (a Dr.Jit PyTree).

    ``passes`` is how many volume vertices the camera subpath may still pass behind it.
    """

    edges: mi.UInt32
    passes: mi.UInt32

    @staticmethod
    def none() -> CameraVertex:
        """Return one of weight 0."""
        return CameraVertex(**vars(KeptVertex.none()), edges=mi.UInt32(0), passes=mi.UInt32(0))


@dataclass
class CameraSubpath:
    """What a camera subpath found by itself, and the vertices that it keeps for connections.

    ``main`` is the first vertex with a wide lobe, ``later`` one of the others, ``glossy`` one of
    the glossy ones, ``mirror_end`` the wide one that mirror connections start from.
    """

    radiance: mi.Spectrum
    main: CameraVertex
    later: CameraVertex
    glossy: CameraVertex
    mirror_end: CameraVertex


@dataclass
class CameraRay:
    """A ray of the camera, drawn with ``density`` per solid angle (a Dr.Jit PyTree).

    It begins at ``o`` on the near clipping plane. ``near`` and ``far`` are the distances of both
    planes along it from the lens.
    """

    o: mi.Point3f
    d: mi.Vector3f
    near: mi.Float
    far: mi.Float
    medium: mi.MediumPtr
    density: mi.Float
    beta: mi.Spectrum


@dr.syntax
def trace_camera_subpath(
    scene: mi.Scene, emission: Emission, start: CameraRay, stream: Stream, limits: PathLimits,
    mirrors: MirrorSet | None, projection_weight: float,
) -> CameraSubpath:  # fmt: skip
    """Trace camera subpaths along the rays of the camera.

    Light vertices that are connected to the camera count ``projection_weight`` times as much as
    other connections.
    """
    # ----------------------------- Configure loop state ------------------------------
    main = CameraVertex.none()  # what is kept, the others by selection weights
    later, glossy, mirror_end = (Reservoir.holding(CameraVertex.none()) for _ in range(3))
    tail = SubpathTail.empty()  # the last vertices
    radiance = mi.Spectrum(0.0)  # emitters met, and direct light
    edges_max, roulette = limits.edges(), limits.roulette()
    free = stream.event(mi.UInt32(1))[0]
    # Georgiev 2012, eqs. 31 and 32: the sum starts from the strategy that connects to the camera.
    state = begin_subpath(
        start.o, start.d, start.medium, start.beta, projection_weight * dr.rcp(start.density),
        mi.Float(0.0), free,
    )  # fmt: skip
    state.length = mi.Float(start.near)
    passes = mi.UInt32(VOLUME_PASSES)  # volume vertices that may still be passed
    event, edges = mi.UInt32(2), mi.UInt32(1)  # where the numbers are; the edge under way
    active = dr.full(mi.Bool, True, dr.width(start.o))  # lanes under way
    while active:
        if not emission.media:
            state = in_vacuum(state)
        # Nothing behind the far plane is seen, but the sky.
        reach = dr.select(edges == 1, start.far, dr.inf)
        state, v, arrived, escaped = trace_segment(scene, state, active, reach)
        # ---------------------------- Emitters that are met ---------------------------
        # Light subpaths of one vertex are not connected to the camera: nothing competes with the
        # first hit.
        d_vcm = dr.select(edges == 1, 0.0, v.d_vcm)
        radiance += emission.met(v, d_vcm, arrived)
        radiance += emission.escaped(state, edges == 1, escaped)
        strategy = connection_weight(v, tail, from_camera=True, first=edges == 1)
        d_vcm = shared_d_vcm(mirrors, v, tail, arrived, from_camera=True, strategy=strategy)
        v.terminal = v.terminal & (passes == 0)
        passes = dr.select(arrived, passes_behind(v, passes), passes)
        tail = dr.select(arrived, tail.then(v), tail)
        v.d_vcm = d_vcm
        # -------------------------------- Direct light --------------------------------
        non_delta = arrived & ~v.delta
        numbers = stream.event(event + EVENT_BLOCK)
        allowed = non_delta & (edges < edges_max)
        square = mi.Point2f(numbers[1], numbers[2])
        radiance += emission.direct(scene, v, numbers[0], square, allowed)
        # --------- Keep the first wide vertex, one of the later, one of the glossy ----
        here = CameraVertex(v, tail.previous, tail.glossy_after_wide, edges, passes)
        wide = non_delta & has_wide_lobe(v)
        is_main = wide & (main.vertex.weight == 0)
        main = dr.select(is_main, here, main)
        later = later.update(here, dr.select(wide & ~is_main, 1.0, 0.0), numbers[3])
        glossy_weight = dr.select(edges == 1, SEEN_GLOSSY_WEIGHT, 1.0)
        glossy = glossy.update(here, dr.select(non_delta & ~wide, glossy_weight, 0.0), numbers[3])
        # ----------------- ... and one where mirror connections start -----------------
        further_numbers = stream.event(event + 2 * EVENT_BLOCK)
        mirror_weight = dr.select(is_main, 1.0, LATER_WEIGHT)
        mirror_end = mirror_end.update(
            here, dr.select(wide, mirror_weight, 0.0), further_numbers[1]
        )
        # -------------------------- Scatter, or end the path --------------------------
        going = arrived & ~v.terminal & (edges < edges_max)
        state, alive = sample_scattering(
            state, v, mi.TransportMode.Radiance, stream.event(event), going
        )
        # Only a specular face leaves no light subpath that could have been connected here.
        passes = dr.select(going & (state.d_vcm == 0), VOLUME_PASSES, passes)
        weight = roulette_weight(state.beta, edges, roulette, further_numbers[0])
        state.beta = dr.select(alive, state.beta * weight, state.beta)
        alive = alive & (weight > 0)
        active &= ~escaped & (~arrived | (going & alive)) & (event < EVENTS_MAX)
        edges += dr.select(arrived, 1, 0)
        event += 1
    for kept in (later, glossy, mirror_end):
        kept.item.vertex.weight = kept.contribution_weight()
    return CameraSubpath(radiance, main, later.item, glossy.item, mirror_end.item)


# -- light subpaths ----------------------------------------------------------------------------


@dataclass
class LightVertex(KeptVertex):
    """A light vertex behind ``edges`` edges (a Dr.Jit PyTree)."""

    vertex: PassableVertex
    edges: mi.UInt32

    @staticmethod
    def none() -> LightVertex:
        """Return one of weight 0."""
        none = PassableVertex.of(empty_vertex())
        return LightVertex(none, dr.zeros(mi.Point3f), mi.Bool(False), mi.UInt32(0))


@dataclass
class LightVertices:
    """Vertices of one light subpath per lane.

    ``kept`` are for connections, each standing for ``represented`` vertices (0 where there is
    none); ``projected`` is for the connection to the camera, with contribution weight
    ``projected_weight``.
    """

    kept: list[LightVertex]
    represented: list[mi.Float]
    projected: LightVertex
    projected_weight: mi.Float
    aperture: mi.Point2f


@dr.syntax
def trace_light_subpath(
    scene: mi.Scene, sensor: mi.Sensor, emission: Emission, stream: Stream, limits: PathLimits,
    mirrors: MirrorSet | None, count: int,
) -> LightVertices:  # fmt: skip
    """Trace one light subpath per lane; keep up to 6 (``count``) of its vertices.

    They are drawn by the light that reaches them, with replacement. Long scattering happens here;
    vertices are connected afterwards (``render.integrators.connections``), by lanes that all do the
    same.
    """
    # ----------------------------- Configure loop state ------------------------------
    edges_max, roulette = limits.edges(), limits.roulette()
    pick, x, y, free = stream.event(mi.UInt32(0))
    u, w, *lens = stream.event(mi.UInt32(1))
    aperture = mi.Point2f(*lens)  # where all vertices of the subpath see the lens
    start = emission.start(pick, mi.Point2f(x, y), u, w)
    state = begin_subpath(start.o, start.d, start.medium, start.beta, start.d_vcm, start.d_vc, free)
    state = PassableState.of(state)
    event, edges = mi.UInt32(2), mi.UInt32(1)  # where the numbers are; the edge under way
    tail = SubpathTail.empty()  # the last vertices
    kept = [Reservoir.holding(LightVertex.none()) for _ in range(count)]
    projected = Reservoir.holding(LightVertex.none())  # for the camera
    active = dr.max(start.beta) > 0  # lanes under way
    while active:
        if not emission.media:
            state = in_vacuum(state)
        state, found, arrived, escaped = trace_segment(scene, state, active)
        v = cast(PassableVertex, found)
        # Light from afar has no distance.
        length = dr.select(start.parallel & (edges == 1), state.length, 1.0)
        v.d_vcm /= dr.square(dr.maximum(length, 1e-20))
        strategy = connection_weight(v, tail, from_camera=False, first=edges == 1)
        d_vcm = shared_d_vcm(mirrors, v, tail, arrived, from_camera=False, strategy=strategy)
        tail = dr.select(arrived, tail.then(v), tail)
        v.d_vcm = d_vcm
        # --------------- Draw by the light that reaches the vertex --------------------
        non_delta = arrived & ~v.delta
        here = LightVertex(v, tail.previous, tail.glossy_after_wide, edges)
        first_numbers = stream.event(event + EVENT_BLOCK)
        target = dr.select(non_delta, channel_mean(v.beta), 0.0)
        last_numbers = stream.event(event + 2 * EVENT_BLOCK)
        numbers = (*first_numbers[1:], *last_numbers[1:])
        for m in range(count):
            kept[m] = kept[m].update(here, target, numbers[m])
        # ------------------ ... and by what it sends to the camera --------------------
        target = _camera_target(sensor, v, aperture, non_delta & (edges < edges_max))
        projected = projected.update(here, target, first_numbers[0])
        # -------------------------- Scatter, or end the path --------------------------
        going = arrived & (edges < edges_max)
        state, alive = sample_scattering(
            state, v, mi.TransportMode.Importance, stream.event(event), going
        )
        # Relative to the start, whose units are the emitter's.
        relative = state.beta / dr.maximum(dr.max(start.beta), 1e-30)
        weight = roulette_weight(relative, edges, roulette, last_numbers[0])
        state.beta = dr.select(alive, state.beta * weight, state.beta)
        alive = alive & (weight > 0)
        active &= ~escaped & (~arrived | alive) & (event < EVENTS_MAX)
        edges += dr.select(arrived, 1, 0)
        event += 1
    return LightVertices(
        [drawn.item for drawn in kept],
        [drawn.contribution_weight(draws=count) for drawn in kept],
        projected.item, projected.contribution_weight(), aperture,
    )  # fmt: skip


def _lens_seen_from(
    sensor: mi.Sensor, v: Vertex, aperture: mi.Point2f, active: mi.Bool
) -> tuple[mi.DirectionSample3f, mi.Spectrum, mi.Bool]:
    """Return a place on the lens as seen from ``v``, its importance, and whether there is any.

    Mitsuba's ``thinlens`` does not ask whether ``v`` is between its clipping planes.
    """
    it = dr.zeros(mi.Interaction3f)
    it.p = v.p
    ds, importance = sensor.sample_direction(it, aperture, active)
    depth = dr.dot(it.p - ds.p, ds.n)
    active = active & (ds.pdf > 0) & (dr.max(importance) > 0)
    return ds, importance, active & (depth >= sensor.near_clip()) & (depth <= sensor.far_clip())


def _camera_target(sensor: mi.Sensor, v: Vertex, aperture: mi.Point2f, active: mi.Bool) -> mi.Float:
    """Return what ``v`` sends to the lens in a vacuum, nothing in the way."""
    ds, importance, active = _lens_seen_from(sensor, v, aperture, active)
    sent = v.beta * scattering_value(v, ds.d, mi.TransportMode.Importance, active) * importance
    return dr.select(active, channel_mean(sent), 0.0)


def connect_to_camera(
    scene: mi.Scene, sensor: mi.Sensor, v: Vertex, aperture: mi.Point2f, projection_weight: float,
    active: mi.Bool,
) -> tuple[mi.Point2f, mi.Spectrum]:  # fmt: skip
    """Return the film position of light vertex ``v`` and its MIS-weighted value there (t = 1).

    Two uniform numbers, ``aperture``, choose a place on the lens. This strategy counts
    ``projection_weight`` times as much as others.
    """
    ds, importance, active = _lens_seen_from(sensor, v, aperture, active)
    value, _, reverse = evaluate_scattering(v, ds.d, mi.TransportMode.Importance, active)
    value = v.beta * value * importance
    active = active & (dr.max(value) > 0)
    eye = empty_vertex()
    # The near clipping plane hides all that is before it.
    near = sensor.near_clip() / dr.select(active, -dr.dot(ds.d, ds.n), 1.0)
    eye.p, eye.volume = ds.p - near * ds.d, mi.Bool(True)
    depth, clear = optical_depth(scene, v, eye, active)
    transmittance = dr.exp(-depth)
    density = density_at(v, ds.d, channel_mean(importance), transmittance, active)
    # Georgiev 2012, eqs. 46 and 37.
    mis = 1.0 / (1.0 + density / projection_weight * strategies_before(v, reverse))
    return ds.uv, dr.select(active & clear, value * transmittance * mis, 0.0)
