"""Light subpaths of the cell sampler, each reduced to the one vertex that stands for it.

Long scattering happens here. The picked vertices are written to memory and joined afterwards to
as many camera subpaths as look at the same place (``render.cells.cell_connections``).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from render.cells.fiber_light import FiberLight
from render.cells.resampling import Promise
from render.paths.lane_memory import LaneMemory
from render.paths.vertex import Vertex, choose, empty_vertex, is_smooth
from render.paths.walk import advance, bounce, start
from render.sampling.proposals import LIGHT_EVENTS

# Events that one light subpath may take; the numbers that pick a vertex come after them.
PICK_EVENT = LIGHT_EVENTS // 2


@dataclass
class Picked:
    """The vertex that stands for a light subpath (a Dr.Jit PyTree).

    ``share`` is total promise over its own, ``before`` the vertex before it and ``(o, d)`` the ray
    that the subpath began with.
    """

    vertex: Vertex
    before: Any
    before_smooth: Any
    share: Any
    o: Any
    d: Any


@dataclass
class LightPicks:
    """``paths`` picked vertices per lane, and ``weight[node]`` of each in the same layout."""

    memory: LaneMemory
    weight: list[Any]
    paths: int


@dr.syntax
def _trace(
    scene: Any, promise: Promise, point: Any, normal: Any, light: FiberLight, fiber: Any,
    stream: Any, paths: int,
) -> LaneMemory:  # fmt: skip
    """Trace and pick; one loop runs all light subpaths of a lane one after the other.

    That keeps SIMD lanes busy: sums of many path lengths differ less than single ones.
    """
    last = mi.UInt32(paths)
    dr.make_opaque(last)
    path, event = mi.UInt32(0), mi.UInt32(0)
    o, d = dr.zeros(mi.Point3f), mi.Vector3f(0, 0, 1)
    head = start(
        o, d, dr.zeros(mi.MediumPtr), mi.Spectrum(1.0), mi.Float(0), mi.Float(0), mi.Float(0.5)
    )
    before, before_smooth = dr.zeros(mi.Point3f), mi.Bool(False)
    picked = Picked(
        empty_vertex(), dr.zeros(mi.Point3f), mi.Bool(False), mi.Float(0),
        dr.zeros(mi.Point3f), mi.Vector3f(0, 0, 1),
    )  # fmt: skip
    promised, total = mi.Float(0.0), mi.Float(0.0)
    memory = LaneMemory(picked, dr.width(fiber), paths)
    fresh = dr.full(mi.Bool, True, dr.width(fiber))
    active = mi.Bool(fresh)
    while active:
        if fresh:
            pick_node, u, v_angle, free = stream.event(path * LIGHT_EVENTS)
            x, y, _, _ = stream.event(path * LIGHT_EVENTS + 1)
            # The paths of a lane divide the direction nodes among themselves.
            stratum = (mi.Float(path) + pick_node) / mi.Float(last)
            o, d = light.sample(fiber, stratum, (u, v_angle), mi.Point2f(x, y))
            # Light comes from outside the scene's surfaces: joining to the fiber end itself, or
            # hitting it by chance, are no strategies here, hence both sums start at 0.
            head = start(
                o, d, dr.zeros(mi.MediumPtr), mi.Spectrum(1.0), mi.Float(0), mi.Float(0), free
            )
            event = path * LIGHT_EVENTS + 2
            before_smooth = mi.Bool(False)
            total = mi.Float(0.0)
        head, v, arrived, escaped = advance(scene, head, active)
        v.terminal = v.terminal | v.diffuse
        # Camera subpaths never sample a volume vertex: no strategy competes for it.
        v.vcm = dr.select(v.volume, 0.0, v.vcm)
        v.vc = dr.select(v.volume, 0.0, v.vc)
        smooth = arrived & is_smooth(v)
        hope = promise.of(v, before_smooth, point, normal, arrived & ~v.delta)
        total += hope
        taken = (hope > 0) & (stream.event(event + PICK_EVENT)[0] * total < hope)
        picked.vertex = choose(taken, v, picked.vertex)
        promised = dr.select(taken, hope, promised)
        picked.before = dr.select(taken, before, picked.before)
        picked.before_smooth = dr.select(taken, before_smooth, picked.before_smooth)
        before = dr.select(arrived, v.p, before)
        before_smooth = dr.select(arrived, smooth, before_smooth)
        head, alive = bounce(head, v, mi.TransportMode.Importance, stream.event(event), arrived)
        event += 1
        cut = event >= path * LIGHT_EVENTS + PICK_EVENT
        fresh = active & (escaped | (arrived & ~alive) | cut)
        picked.o = o
        picked.d = d
        picked.share = dr.select(total > 0, total / promised, 0.0)
        memory.write(path, picked, fresh)
        path += dr.select(fresh, 1, 0)
        active = active & (path < last)
    return memory


def light_picks(
    scene: Any, promise: Promise, point: Any, normal: Any, light: FiberLight, fiber: Any,
    stream: Any, paths: int,
) -> LightPicks:  # fmt: skip
    """Return picked vertices for the ``point`` of the coating that each lane looks at."""
    memory = _trace(scene, promise, point, normal, light, fiber, stream, paths)
    dr.eval(memory.records)
    records = memory.records
    lane: Any = dr.arange(mi.UInt32, paths * memory.lanes) % memory.lanes
    of_node = light.weights(dr.gather(mi.UInt32, fiber, lane), records.o, records.d)
    weight = [value * records.share / paths for value in of_node]
    dr.eval(weight)
    return LightPicks(memory, weight, paths)
