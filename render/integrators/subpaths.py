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
from itertools import zip_longest
from typing import cast

import drjit as dr
import mitsuba as mi

from render.errors import RenderError
from render.integrators.emitters import Emission, EmittedRay
from render.integrators.mirror_connections import MirrorSet, connection_weight
from render.integrators.supported_content import class_of
from render.paths.mirrors import KeptVertex, SubpathTail, shared_d_vcm
from render.paths.records import DrawnRecords
from render.paths.vertex import (
    VOLUME_PASSES,
    EitherMode,
    PassableVertex,
    Vertex,
    channel_mean,
    empty_vertex,
    evaluate_scattering,
    has_wide_lobe,
    passes_behind,
)
from render.paths.walk import (
    PassableState,
    SubpathState,
    begin_subpath,
    in_vacuum,
    sample_scattering,
    trace_segment,
)
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


MAIN, LATER, GLOSSY, MIRROR_END = range(4)
"""What camera subpaths keep for connections: the first vertex with a wide lobe, one of the others,
one of the glossy ones, and the wide one that mirror connections start from."""
_CONSTANT = ("weight", "delta")
"""Fields that are the same for all vertices that are kept."""
_OF_MIRRORS = ("previous", "glossy_after_wide")
"""Those that nothing reads without mirrors."""
_OF_MEDIA = ("medium", "phase", "volume", "terminal", "passes", "d_vc_passing")
"""Those that are the same as well in scenes without media."""


@dataclass
class SubpathVertex(KeptVertex):
    """A vertex for connections, behind ``edges`` edges (a Dr.Jit PyTree).

    ``passes`` is how many volume vertices a camera subpath may still pass behind it.
    """

    vertex: PassableVertex
    edges: mi.UInt32
    passes: mi.UInt32

    @staticmethod
    def none() -> SubpathVertex:
        """Return one of weight 0."""
        none = PassableVertex.of(empty_vertex())
        zero = mi.UInt32(0)
        return SubpathVertex(none, dr.zeros(mi.Point3f), mi.Bool(False), zero, zero)


@dataclass
class SubpathStart:
    """Where subpaths begin: at an emitter (``of_light``), or at the camera (a Dr.Jit PyTree).

    Rays of the camera begin on the near clipping plane; ``near`` and ``far`` are the distances of
    both planes along them from the lens. ``place`` is where they meet the film, or where on the
    lens all vertices of a light subpath are seen; ``free`` draws the first free path.
    """

    of_light: mi.Bool
    ray: EmittedRay
    near: mi.Float
    far: mi.Float
    place: mi.Point2f
    free: mi.Float


@dataclass
class _Walk:
    """The state of the loop over events (a Dr.Jit PyTree).

    ``tail`` are the last vertices, ``event`` is where the numbers are, ``edges`` the edge under
    way, ``passes`` how many volume vertices the camera may still pass, ``radiance`` that of
    emitters met and of direct light.
    """

    state: SubpathState
    tail: SubpathTail
    event: mi.UInt32
    edges: mi.UInt32
    passes: mi.UInt32
    radiance: mi.Spectrum


class SubpathTracer:
    """Both kinds of subpaths of one scene, lane by lane, by one loop that is compiled once."""

    def __init__(
        self, scene: mi.Scene, sensor: mi.Sensor, emission: Emission, limits: PathLimits,
        mirrors: MirrorSet | None,
    ) -> None:  # fmt: skip
        """Take what subpaths know of the scene."""
        self.scene, self.sensor, self.emission, self.mirrors = scene, sensor, emission, mirrors
        self.limits, self.media = limits, emission.media
        flags = [shape.bsdf().flags() for shape in scene.shapes() if shape.bsdf() is not None]
        # What is in groups of shapes is not shown.
        hidden = any(class_of(shape) == "Instance" for shape in scene.shapes())
        self.refracts = hidden or any(_refracts(kinds) for kinds in flags)
        # Kernels of simple scenes know that all is alike: so much less is compiled.
        self.like = SubpathVertex.none()
        self.constant: tuple[str, ...] = _CONSTANT + (_OF_MIRRORS if mirrors is None else ())
        if not self.media:
            self.constant += _OF_MEDIA
            if not (hidden or any(_is_glossy(kinds) for kinds in flags)):
                self.constant += ("diffuse",)
                self.like.vertex.diffuse = mi.Bool(True)

    @dr.syntax
    def trace(
        self, start: SubpathStart, stream: Stream, count: int
    ) -> tuple[mi.Spectrum, DrawnRecords]:
        """Return what subpaths find by themselves, and the vertices that they keep.

        Those of the camera are ``MAIN`` to ``MIRROR_END``; light subpaths keep ``count`` drawn by
        the light that reaches them, with replacement, and one by what it sends to the camera. Long
        scattering happens here; vertices are connected afterwards
        (``render.integrators.connections``), by lanes that all do the same.
        """
        of_light, walk = start.of_light, self._begun(start)
        camera_count = MIRROR_END if self.mirrors is None else MIRROR_END + 1
        reservoirs = max(camera_count, count + 1)
        slots = DrawnRecords(self.like, dr.width(of_light), reservoirs, self.constant)
        drawn = slots.nothing
        # Relative to the start, whose units are the emitter's.
        unit = dr.select(of_light, dr.rcp(dr.maximum(dr.max(start.ray.beta), 1e-30)), 1.0)
        edges_max, roulette = self.limits.edges(), self.limits.roulette()
        active = dr.max(start.ray.beta) > 0  # lanes under way
        # What a loop does not change is no part of its state: to find that, it is traced twice.
        while dr.hint(active, exclude=[start, stream, slots, of_light, unit, edges_max, roulette]):
            edges, event = walk.edges, walk.event
            v, met, arrived, escaped = self._arrive(start, walk, active)
            # ------------ Emitters and direct light, or what is sent to the camera ------------
            several = (event + k * EVENT_BLOCK for k in range(3))
            scattering, numbers, further = stream.events(*several)
            allowed = arrived & ~v.delta & (edges < edges_max)
            square, found = mi.Point2f(numbers[1], numbers[2]), mi.Spectrum(0.0)
            from_camera = ~of_light
            lit, seen = allowed & from_camera, allowed & of_light
            sample = self.emission.seen_from(v, numbers[0], square, lit)
            lens, importance, seen = lens_seen_from(self.sensor, v, start.place, seen)
            seen |= lit & (sample.pdf > 0) & (dr.max(sample.received) > 0)
            toward = dr.select(of_light, lens.d, sample.d)
            mode = EitherMode(of_light, self.refracts)
            scattered = evaluate_scattering(v, toward, mode, seen)
            # To the lens in a vacuum, nothing in the way.
            sent = channel_mean(v.beta * scattered[0] * importance)
            sent = dr.select(seen & of_light, sent, 0.0)
            if from_camera:
                found = met + self.emission.direct(v, sample, scattered, seen)
            walk.radiance += found
            # ----------------------------- Keep it, or do not ---------------------------------
            received = dr.select(arrived & ~v.delta, channel_mean(v.beta), 0.0)
            tail = walk.tail
            here = SubpathVertex(v, tail.previous, tail.glossy_after_wide, edges, walk.passes)
            of_camera = _camera_weights(v, arrived, edges == 1, drawn[MAIN].weight == 0)
            weights = _by_kind(of_light, [*([received] * count), sent], of_camera, reservoirs)
            draws = [*[*numbers[1:], *further[1:]][:count], numbers[0]]
            draws = _by_kind(of_light, draws, [*([numbers[3]] * 3), further[1]], reservoirs)
            drawn = slots.updated(drawn, here, weights, draws)
            # ---------------------------- Scatter, or end the path ----------------------------
            going = arrived & (of_light | ~v.terminal) & (edges < edges_max)
            state, alive = sample_scattering(walk.state, v, mode, scattering, going)
            # Only a specular face leaves no light subpath that could have been connected here.
            walk.passes = dr.select(going & (state.d_vcm == 0), VOLUME_PASSES, walk.passes)
            # Free paths need no number where there are no media.
            number = further[0] if self.media else scattering[0]
            weight = roulette_weight(state.beta * unit, edges, roulette, number)
            state.beta = dr.select(alive, state.beta * weight, state.beta)
            walk.state = state
            active &= ~escaped & (~arrived | (alive & (weight > 0))) & (event < EVENTS_MAX)
            walk.edges = edges + dr.select(arrived, 1, 0)
            walk.event = event + 1
        sharing = [dr.select(of_light, float(count), 1.0)] * count + [mi.Float(1.0)] * reservoirs
        dr.schedule(walk.radiance)  # by the same kernel
        slots.keep(drawn, sharing[:reservoirs])
        return walk.radiance, slots

    def _begun(self, start: SubpathStart) -> _Walk:
        """Return the state of subpaths that have only begun."""
        ray = start.ray
        state = begin_subpath(ray.o, ray.d, ray.medium, ray.beta, ray.d_vcm, ray.d_vc, start.free)
        state.length = mi.Float(start.near)
        state = PassableState.of(state) if self.media else state
        passes, radiance = mi.UInt32(VOLUME_PASSES), mi.Spectrum(0.0)
        return _Walk(state, SubpathTail.empty(), mi.UInt32(2), mi.UInt32(1), passes, radiance)

    @dr.syntax
    def _arrive(
        self, start: SubpathStart, walk: _Walk, active: mi.Bool
    ) -> tuple[PassableVertex, mi.Spectrum, mi.Bool, mi.Bool]:
        """Let a subpath go on to a vertex; return it and what the camera meets of emitters.

        Also returned is whether it is one, and whether light escaped (``trace_segment``).
        """
        from_camera, first = ~start.of_light, walk.edges == 1
        if not self.media:
            walk.state = in_vacuum(walk.state)
        # Nothing behind the far plane is seen, but the sky.
        reach = dr.select(first, start.far, dr.inf)
        walk.state, v, arrived, escaped = trace_segment(
            self.scene, walk.state, active, reach, self.emission.nulls
        )
        # Light from afar has no distance.
        length = dr.select(start.ray.parallel & first, walk.state.length, 1.0)
        v.d_vcm /= dr.square(dr.maximum(length, 1e-20))
        met = mi.Spectrum(0.0)
        if from_camera:
            # Light subpaths of one vertex are not connected to the camera: nothing competes with
            # the first hit.
            met = self.emission.met(v, dr.select(first, 0.0, v.d_vcm), arrived)
            met += self.emission.escaped(walk.state, first, escaped)
        strategy = connection_weight(v, walk.tail, from_camera, first)
        d_vcm = shared_d_vcm(self.mirrors, v, walk.tail, arrived, from_camera, strategy)
        v.terminal = v.terminal & (start.of_light | (walk.passes == 0))
        walk.passes = dr.select(arrived, passes_behind(v, walk.passes), walk.passes)
        walk.tail = dr.select(arrived, walk.tail.then(v), walk.tail)
        v.d_vcm = d_vcm
        return cast(PassableVertex, v), met, arrived, escaped


def _refracts(flags: int) -> bool:
    """Return whether radiance and importance may be scattered otherwise by such a BSDF."""
    kinds = (mi.BSDFFlags.DeltaTransmission, mi.BSDFFlags.GlossyTransmission)
    return any(mi.has_flag(flags, kind) for kind in kinds)


def _is_glossy(flags: int) -> bool:
    """Return whether vertices with such a BSDF are kept and not diffuse."""
    smooth = mi.has_flag(flags, mi.BSDFFlags.Smooth)
    return bool(smooth and not mi.has_flag(flags, mi.BSDFFlags.Diffuse))


def _camera_weights(
    v: Vertex, arrived: mi.Bool, first: mi.Bool, is_main: mi.Bool
) -> list[mi.Float]:
    """Return the selection weights of ``v`` on a camera subpath: ``MAIN`` to ``MIRROR_END``."""
    non_delta = arrived & ~v.delta
    wide = non_delta & has_wide_lobe(v)
    glossy = dr.select(first, SEEN_GLOSSY_WEIGHT, 1.0)
    return [
        dr.select(wide & is_main, 1.0, 0.0),
        dr.select(wide & ~is_main, 1.0, 0.0),
        dr.select(non_delta & ~wide, glossy, 0.0),
        dr.select(wide, dr.select(is_main, 1.0, LATER_WEIGHT), 0.0),
    ]


def _by_kind(
    of_light: mi.Bool, light: list[mi.Float], camera: list[mi.Float], count: int
) -> list[mi.Float]:
    """Return numbers of ``count`` reservoirs, those of light or of camera subpaths."""
    pairs = zip_longest(light, camera, fillvalue=mi.Float(0.0))
    return [dr.select(of_light, *pair) for pair in pairs][:count]


def lens_seen_from(
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
