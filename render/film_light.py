"""Light subpaths of the film sampler: projections onto the film, and joins to camera subpaths.

Every light vertex is projected, and joined to one of the later camera vertices. Joins to the first
smooth camera vertex, and bridges, are made once, after the loop and by all lanes: one vertex per
subpath, drawn by its promise (``render.film_promise``), stands for all.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, cast

import drjit as dr
import mitsuba as mi

from render.connect import join, optical_depth
from render.emission import Emission
from render.film_bridge import Mirrors, Trail, bridge, competing, counted, is_smooth
from render.film_camera import CameraPart, Kept
from render.film_paths import EVENTS, SPARE, Limits, survive
from render.film_promise import mirrored, promise, through
from render.primary import Stream
from render.segments import OpenHead, advance, bounce, start
from render.vertex import OpenVertex, Vertex, area_factor, choose, empty_vertex, extinction, scatter


@dataclass
class Picked:
    """The light vertex that stands for its subpath, behind ``edges`` edges (a Dr.Jit PyTree).

    ``hope`` is its promise, ``total`` that of all that were offered.
    """

    vertex: OpenVertex
    edges: Any
    trail: Trail
    hope: Any
    total: Any

    @staticmethod
    def empty() -> Picked:
        """Return none yet."""
        none: OpenVertex = OpenVertex(**vars(empty_vertex()), vc_open=mi.Float(0.0))
        return Picked(none, mi.UInt32(0), Trail.empty(), mi.Float(0.0), mi.Float(0.0))

    def offered(self, v: OpenVertex, edges: Any, trail: Trail, hope: Any, number: Any) -> Picked:
        """Return this, or ``v``, which ends ``trail``, with probability by its ``hope``."""
        total = self.total + hope
        taken = (hope > 0) & (number * total < hope)
        return Picked(
            choose(taken, v, self.vertex),
            dr.select(taken, edges, self.edges),
            trail.where(taken, self.trail),
            dr.select(taken, hope, self.hope),
            total,
        )

    def share(self) -> Any:
        """Return how many such vertices this one stands for."""
        return dr.select(self.hope > 0, self.total / self.hope, 0.0)


def project(scene: Any, sensor: Any, v: Vertex, active: Any) -> tuple[Any, Any]:
    """Return the film position of light vertex ``v`` and its MIS-weighted value there (t = 1)."""
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
    density = dr.mean(importance) * area_factor(v, ds.d) * reach
    reverse = dr.select(v.terminal, 0.0, reverse)
    mis = 1.0 / (1.0 + density * (v.vcm + v.vc * reverse))
    return ds.uv, dr.select(active & clear, value * transmittance * mis, 0.0)


@dr.syntax
def light_part(
    scene: Any,
    sensor: Any,
    emission: Emission,
    camera: CameraPart,
    stream: Stream,
    limits: Limits,
    mirrors: Mirrors | None,
) -> tuple[Any, Any, Any]:
    """Trace one light subpath per lane; return joined radiance, and one splat with its position.

    The splat is one projected light vertex, drawn in proportion to its value and worth the sum.
    """
    most, roulette = limits.edges(), limits.roulette()
    pick, x, y, free = stream.event(mi.UInt32(0))
    u, w, _, _ = stream.event(mi.UInt32(1))
    begin = emission.start(pick, mi.Point2f(x, y), u, w)
    head = start(begin.o, begin.d, begin.medium, begin.beta, begin.vcm, begin.vc, free)
    head = OpenHead(**vars(head), vc_open=mi.Float(begin.vc))
    event, edges = mi.UInt32(2), mi.UInt32(1)
    trail = Trail.empty()
    picked, over, joined = Picked.empty(), Picked.empty(), mi.Spectrum(0.0)
    splat, total, where = mi.Spectrum(0.0), mi.Float(0.0), mi.Point2f(0.0)
    active = dr.max(begin.beta) > 0
    while active:
        head, found, arrived, escaped = advance(scene, head, active)
        v = cast(OpenVertex, found)
        v.vcm = counted(mirrors, v, trail, arrived, from_camera=False)
        trail = trail.then(v, arrived)
        smooth = arrived & ~v.delta
        spare = stream.event(event + SPARE)
        other = camera.other
        fits = smooth & (edges + other.edges < most)
        joined += _join(scene, mirrors, v, trail, other, fits)
        clear = through(scene, v, camera.main.vertex, smooth)
        hope = clear * promise(v, camera.main.vertex, smooth)
        picked = picked.offered(v, edges, trail, hope, spare[1])
        if mirrors is not None:
            hope = clear * mirrored(mirrors, v, camera.anchor.vertex, smooth & is_smooth(v))
            over = over.offered(v, edges, trail, hope, spare[2])
        uv, value = project(scene, sensor, _seen_from(v, mi.Bool(False)), smooth & (edges < most))
        amount = dr.mean(value)
        total += amount
        taken = (amount > 0) & (spare[0] * total < amount)
        splat = dr.select(taken, value / amount, splat)
        where = dr.select(taken, uv, where)
        going = arrived & (edges < most)
        head, alive = bounce(head, v, mi.TransportMode.Importance, stream.event(event), going)
        # Relative to the start, whose units are the emitter's.
        relative = head.beta / dr.maximum(dr.max(begin.beta), 1e-30)
        weight = survive(relative, edges, roulette, stream.event(event + 2 * SPARE)[0])
        head.beta = dr.select(alive, head.beta * weight, head.beta)
        alive = alive & (weight > 0)
        active &= ~escaped & (~arrived | alive) & (event < EVENTS)
        edges += dr.select(arrived, 1, 0)
        event += 1
    main = camera.main
    fits = (picked.hope > 0) & (picked.edges + main.edges < most)
    joined += _join(scene, mirrors, picked.vertex, picked.trail, main, fits) * picked.share()
    if mirrors is not None:
        anchor, numbers = camera.anchor, stream.event(mi.UInt32(SPARE))
        fits = (over.hope > 0) & (over.edges + anchor.edges + 1 < most)
        y = _seen_from(over.vertex, anchor.closed)
        joined += bridge(scene, mirrors, y, anchor.vertex, numbers[:3], fits) * over.share()
    return joined, _scaled(splat, total), where


def _seen_from(y: OpenVertex, closed: Any) -> Vertex:
    """Return ``y`` with its sums for camera subpaths that arrive ``closed`` or open."""
    seen = replace(y)
    seen.terminal = y.terminal & closed
    seen.vc = dr.select(closed | y.diffuse, y.vc, y.vc_open)
    return seen


def _join(
    scene: Any, mirrors: Mirrors | None, y: OpenVertex, trail: Trail, kept: Kept, active: Any
) -> Any:
    """Return the light of ``y``, which ends ``trail``, at a kept camera vertex."""
    z = kept.vertex
    further = competing(mirrors, y, trail, z, kept.before, kept.waiting, active)
    return join(scene, _seen_from(y, kept.closed), z, active, extra=further)


def _scaled(spectrum: Any, factor: Any) -> Any:
    return spectrum * factor
