"""Light subpaths of the film sampler: a few vertices of each, for joins and for the film.

Long scattering happens here. Vertices are drawn by reservoirs and written to memory; they are
joined to camera subpaths (``render.integrators.connections``) and projected onto the film
afterwards, by lanes that all do the same.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, cast

import drjit as dr
import mitsuba as mi

from render.integrators.emitters import Emission
from render.integrators.mirror_connections import Mirrors, Trail, counted
from render.integrators.path_limits import EVENTS, SPARE, PathLimits, survive
from render.paths.connect import optical_depth
from render.paths.vertex import (
    OpenVertex,
    Vertex,
    area_factor,
    choose,
    empty_vertex,
    extinction,
    left_after,
    scatter,
    value,
    vc_of,
)
from render.paths.walk import OpenHead, advance, bounce, start
from render.sampling.streams import Stream


@dataclass
class LightVertex:
    """A light vertex behind ``edges`` edges, which ends ``trail`` (a Dr.Jit PyTree)."""

    vertex: OpenVertex
    edges: Any
    trail: Trail

    def where(self, condition: Any, other: LightVertex) -> LightVertex:
        """Return this where ``condition`` holds, else ``other``."""
        return LightVertex(
            choose(condition, self.vertex, other.vertex),
            dr.select(condition, self.edges, other.edges),
            self.trail.where(condition, other.trail),
        )

    @staticmethod
    def empty() -> LightVertex:
        """Return one of weight 0."""
        none: OpenVertex = OpenVertex(**vars(empty_vertex()), vc_open=mi.Vector2f(0.0))
        return LightVertex(none, mi.UInt32(0), Trail.empty())


@dataclass
class LightVertices:
    """Vertices of one light subpath per lane.

    ``picks`` are for joins, each standing for ``shares`` vertices (0 where there is none);
    ``shown`` is for the film and stands for ``shown_share``.
    """

    picks: list[LightVertex]
    shares: list[Any]
    shown: LightVertex
    shown_share: Any


def project(scene: Any, sensor: Any, v: Vertex, projected: float, active: Any) -> tuple[Any, Any]:
    """Return the film position of light vertex ``v`` and its MIS-weighted value there (t = 1).

    This strategy counts ``projected`` times as much as others.
    """
    it = dr.zeros(mi.Interaction3f)
    it.p = v.p
    ds, importance = sensor.sample_direction(it, mi.Point2f(0.5), active)
    active = active & (ds.pdf > 0) & (dr.max(importance) > 0)
    value, _, reverse = scatter(v, ds.d, mi.TransportMode.Importance, active)
    value = v.beta * value * importance
    active = active & (dr.max(value) > 0)
    eye = empty_vertex()
    eye.p, eye.volume = ds.p, mi.Bool(True)
    depth, clear = optical_depth(scene, v, eye, active)
    transmittance = dr.exp(-depth)
    _, sigma_v = extinction(v.medium, active & v.volume)
    reach = dr.select(v.volume, dr.mean(sigma_v * transmittance), dr.mean(transmittance))
    density = dr.mean(importance) * area_factor(v, ds.d) * reach / projected
    reverse = dr.select(v.terminal, 0.0, reverse)
    mis = 1.0 / (1.0 + density * (v.vcm + v.vc * reverse))
    return ds.uv, dr.select(active & clear, value * transmittance * mis, 0.0)


def _shown(sensor: Any, v: Vertex, active: Any) -> Any:
    """Return what ``v`` sends to the lens in a vacuum, nothing in the way."""
    it = dr.zeros(mi.Interaction3f)
    it.p = v.p
    ds, importance = sensor.sample_direction(it, mi.Point2f(0.5), active)
    active = active & (ds.pdf > 0) & (dr.max(importance) > 0)
    sent = v.beta * value(v, ds.d, mi.TransportMode.Importance, active) * importance
    return dr.select(active, dr.mean(sent), 0.0)


@dr.syntax
def light_part(
    scene: Any, sensor: Any, emission: Emission, stream: Stream, limits: PathLimits,
    mirrors: Mirrors | None, picks: int,
) -> LightVertices:  # fmt: skip
    """Trace one light subpath per lane; return up to 6 ``picks`` of its vertices.

    They are drawn by the light that reaches them, with replacement.
    """
    most, roulette = limits.edges(), limits.roulette()
    pick, x, y, free = stream.event(mi.UInt32(0))
    u, w, _, _ = stream.event(mi.UInt32(1))
    begin = emission.start(pick, mi.Point2f(x, y), u, w)
    head = start(begin.o, begin.d, begin.medium, begin.beta, begin.vcm, begin.vc, free)
    head = OpenHead(**vars(head), vc_open=mi.Vector2f(begin.vc))
    event, edges = mi.UInt32(2), mi.UInt32(1)
    trail = Trail.empty()
    hopes = [mi.Float(0.0) for _ in range(picks + 1)]
    kept = [LightVertex.empty() for _ in range(picks + 1)]
    total, shown = mi.Float(0.0), mi.Float(0.0)
    active = dr.max(begin.beta) > 0
    while active:
        head, found, arrived, escaped = advance(scene, head, active)
        v = cast(OpenVertex, found)
        vcm = counted(mirrors, v, trail, arrived, from_camera=False, first=edges == 1)
        trail = trail.then(v, arrived)
        v.vcm = vcm
        smooth = arrived & ~v.delta
        record = LightVertex(v, edges, trail)
        spare = stream.event(event + SPARE)
        hope = dr.select(smooth, dr.mean(v.beta), 0.0)
        total += hope
        last = stream.event(event + 2 * SPARE)
        numbers = (*spare[1:], *last[1:])
        for m in range(picks):
            taken = (hope > 0) & (numbers[m] * total < hope)
            hopes[m] = dr.select(taken, hope, hopes[m])
            kept[m] = record.where(taken, kept[m])
        hope = _shown(sensor, v, smooth & (edges < most))
        shown += hope
        taken = (hope > 0) & (spare[0] * shown < hope)
        hopes[picks] = dr.select(taken, hope, hopes[picks])
        kept[picks] = record.where(taken, kept[picks])
        going = arrived & (edges < most)
        head, alive = bounce(head, v, mi.TransportMode.Importance, stream.event(event), going)
        # Relative to the start, whose units are the emitter's.
        relative = head.beta / dr.maximum(dr.max(begin.beta), 1e-30)
        weight = survive(relative, edges, roulette, last[0])
        head.beta = dr.select(alive, head.beta * weight, head.beta)
        alive = alive & (weight > 0)
        active &= ~escaped & (~arrived | alive) & (event < EVENTS)
        edges += dr.select(arrived, 1, 0)
        event += 1
    shares = [dr.select(h > 0, total / (picks * h), 0.0) for h in hopes[:picks]]
    shown_share = dr.select(hopes[picks] > 0, shown / hopes[picks], 0.0)
    return LightVertices(kept[:picks], shares, kept[picks], shown_share)


def seen_from(y: OpenVertex, left: Any) -> Vertex:
    """Return ``y`` with its sums for camera subpaths that may still pass ``left`` volumes."""
    seen = replace(y)
    seen.terminal = y.terminal & (left == 0)
    seen.vc = vc_of(y, left_after(y, left))
    return seen
