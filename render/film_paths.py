"""Bidirectional paths between the emitters of any scene and the pixels of a film.

All strategies (s light vertices, t camera vertices) are combined by the balance heuristic with
recursive sums (Georgiev 2012): emitters that a camera subpath meets (s = 0), direct light
(s = 1), joins of light vertices with two kept camera vertices (s, t >= 2), and light vertices
projected onto the film (t = 1). Camera subpaths are absorbed in volumes at their first vertex, so
long scattering belongs to the light subpath and no path is ever stored.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from render.connect import join, optical_depth
from render.emission import Emission
from render.errors import RenderError
from render.primary import Stream
from render.segments import advance, bounce, start
from render.vertex import Vertex, area_factor, choose, empty_vertex, extinction, scatter

# Second event of the same vertex: direct light and reservoirs draw from here on.
SPARE = 2048
EVENTS = 2000
"""Events that one subpath may take, null boundaries included."""


@dataclass(frozen=True)
class Limits:
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
                value=self.max_depth,
            )
        if self.rr_depth < 1:
            raise RenderError(
                f"rr_depth = {self.rr_depth}, allowed: at least 1",
                field="rr_depth",
                value=self.rr_depth,
            )

    def edges(self) -> Any:
        """Return the greatest number of edges as an opaque integer."""
        value = mi.UInt32(self.max_depth if self.max_depth >= 0 else 1 << 30)
        dr.make_opaque(value)
        return value

    def roulette(self) -> Any:
        """Return the first edge with Russian roulette as an opaque integer."""
        value = mi.UInt32(self.rr_depth)
        dr.make_opaque(value)
        return value


@dataclass
class CameraPart:
    """What a camera subpath found by itself, and the vertices that it keeps for joins."""

    radiance: Any
    kept: list[Vertex]
    edges: list[Any]


def survive(beta: Any, edges: Any, roulette: Any, number: Any) -> Any:
    """Return the weight of Russian roulette: 0 where the path ends."""
    keep = dr.clip(dr.max(beta), 0.05, 0.99)
    keep = dr.select(edges >= roulette, keep, 1.0)
    return dr.select(number < keep, dr.rcp(keep), 0.0)


@dr.syntax
def camera_part(
    scene: Any, emission: Emission, ray: Any, medium: Any, density: Any, beta: Any,
    stream: Stream, limits: Limits,
) -> CameraPart:  # fmt: skip
    """Trace camera subpaths along ``ray``, which was drawn with ``density`` per solid angle."""
    first, diffuse, end, other = (empty_vertex() for _ in range(4))
    first_edges, diffuse_edges, end_edges, other_edges = (mi.UInt32(0) for _ in range(4))
    others = mi.Float(0.0)
    radiance = mi.Spectrum(0.0)
    most, roulette = limits.edges(), limits.roulette()
    free = stream.event(mi.UInt32(1))[0]
    head = start(ray.o, ray.d, medium, beta, dr.rcp(density), mi.Float(0.0), free)
    event, edges = mi.UInt32(2), mi.UInt32(1)
    active = dr.full(mi.Bool, True, dr.width(ray.o))
    while active:
        head, v, arrived, escaped = advance(scene, head, active)
        # Light subpaths of one vertex are not projected: nothing competes with the first hit.
        competing = dr.select(edges == 1, 0.0, v.vcm)
        radiance += emission.seen(v, competing, arrived)
        smooth = arrived & ~v.delta
        spare = stream.event(event + SPARE)
        allowed = smooth & (edges < most)
        radiance += emission.direct(scene, v, spare[0], mi.Point2f(spare[1], spare[2]), allowed)
        begins = smooth & (first.weight == 0)
        first = choose(begins, v, first)
        first_edges = dr.select(begins, edges, first_edges)
        later = smooth & ~begins
        bright = later & v.diffuse & (diffuse.weight == 0)
        diffuse = choose(bright, v, diffuse)
        diffuse_edges = dr.select(bright, edges, diffuse_edges)
        ends = later & v.volume
        end = choose(ends, v, end)
        end_edges = dr.select(ends, edges, end_edges)
        # Reservoir of size 1: each of the rest is kept with the same probability.
        rest = later & ~bright & ~ends
        others += dr.select(rest, 1.0, 0.0)
        taken = rest & (spare[3] * others < 1.0)
        other = choose(taken, v, other)
        other_edges = dr.select(taken, edges, other_edges)
        numbers = stream.event(event)
        going = arrived & ~v.terminal & (edges < most)
        head, alive = bounce(head, v, mi.TransportMode.Radiance, numbers, going)
        weight = survive(head.beta, edges, roulette, stream.event(event + 2 * SPARE)[0])
        head.beta = dr.select(alive, head.beta * weight, head.beta)
        alive = alive & (weight > 0)
        active &= ~escaped & (~arrived | (going & alive)) & (event < EVENTS)
        edges += dr.select(arrived, 1, 0)
        event += 1
    other.weight = others
    return CameraPart(
        radiance,
        [first, diffuse, end, other],
        [first_edges, diffuse_edges, end_edges, other_edges],
    )


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
    scene: Any, sensor: Any, emission: Emission, camera: CameraPart, stream: Stream, limits: Limits
) -> tuple[Any, Any, Any]:
    """Trace one light subpath per lane; return joined radiance, and one splat with its position.

    The splat is one projected light vertex, drawn in proportion to its value and worth the sum.
    """
    most, roulette = limits.edges(), limits.roulette()
    pick, x, y, free = stream.event(mi.UInt32(0))
    u, w, _, _ = stream.event(mi.UInt32(1))
    begin = emission.start(pick, mi.Point2f(x, y), u, w)
    head = start(begin.o, begin.d, begin.medium, begin.beta, begin.vcm, begin.vc, free)
    event, edges = mi.UInt32(2), mi.UInt32(1)
    joined = mi.Spectrum(0.0)
    splat, total, where = mi.Spectrum(0.0), mi.Float(0.0), mi.Point2f(0.0)
    active = dr.max(begin.beta) > 0
    while active:
        head, v, arrived, escaped = advance(scene, head, active)
        smooth = arrived & ~v.delta
        spare = stream.event(event + SPARE)
        for i in range(4):
            fits = smooth & (edges + camera.edges[i] < most)
            joined += join(scene, v, camera.kept[i], fits)
        uv, value = project(scene, sensor, v, smooth & (edges < most))
        amount = dr.mean(value)
        total += amount
        taken = (amount > 0) & (spare[0] * total < amount)
        splat = dr.select(taken, value / amount, splat)
        where = dr.select(taken, uv, where)
        going = arrived & (edges < most)
        head, alive = bounce(head, v, mi.TransportMode.Importance, stream.event(event), going)
        # Relative to the start, whose units are the emitter's.
        relative = head.beta / dr.maximum(dr.max(begin.beta), 1e-30)
        weight = survive(relative, edges, roulette, spare[1])
        head.beta = dr.select(alive, head.beta * weight, head.beta)
        alive = alive & (weight > 0)
        active &= ~escaped & (~arrived | alive) & (event < EVENTS)
        edges += dr.select(arrived, 1, 0)
        event += 1
    return joined, _scaled(splat, total), where


def _scaled(spectrum: Any, factor: Any) -> Any:
    return spectrum * factor
