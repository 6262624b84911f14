"""Light subpaths of the cell sampler, joined to camera subpaths: the estimator behind every cell.

A camera subpath sees one facet (``render.cell_camera``); light subpaths start at one fiber. One
vertex of each light subpath, drawn by its promise (``render.resampling``), is joined to every kept
vertex of the camera subpath, directly and over a bridge, with MIS weights over all the ways in
which the same path could have been found (``render.connect.join``).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from render.bridge import Bridge
from render.cell_camera import CameraSubpath
from render.chains import LIGHT_EVENTS
from render.connect import join
from render.fiber_light import FiberLight
from render.lane_memory import LaneMemory
from render.resampling import Promise
from render.segments import Aim, advance, bounce, start
from render.vertex import Vertex, choose, empty_vertex

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


def _nothing() -> Picked:
    """Return no vertex, for loops that have not picked one yet."""
    return Picked(
        empty_vertex(), dr.zeros(mi.Point3f), mi.Bool(False), mi.Float(0),
        dr.zeros(mi.Point3f), mi.Vector3f(0, 0, 1),
    )  # fmt: skip


@dr.syntax
def light_subpaths(
    scene: Any,
    camera: CameraSubpath,
    light: FiberLight,
    fiber: Any,
    stream: Any,
    paths: int,
    aim: Aim,
    bridge: Bridge,
    promise: Promise,
) -> list[Any]:
    """Return, per direction node, the mean over ``paths`` light subpaths of the joined radiance.

    One loop runs all light subpaths of a lane one after the other, which keeps SIMD lanes busy:
    sums of many path lengths differ less than single ones.
    """
    last = mi.UInt32(paths)
    dr.make_opaque(last)
    path, event = mi.UInt32(0), mi.UInt32(0)
    o, d = dr.zeros(mi.Point3f), mi.Vector3f(0, 0, 1)
    head = start(
        o, d, dr.zeros(mi.MediumPtr), mi.Spectrum(1.0), mi.Float(0), mi.Float(0), mi.Float(0.5)
    )
    before, before_smooth = dr.zeros(mi.Point3f), mi.Bool(False)
    picked, promised, total = _nothing(), mi.Float(0.0), mi.Float(0.0)
    kept = LaneMemory(picked, dr.width(fiber), paths)
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
        joined = arrived & ~v.delta
        smooth = arrived & (v.volume | v.diffuse)
        hope = promise.of(v, camera.facet, joined)
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
        kept.write(path, picked, fresh)
        path += dr.select(fresh, 1, 0)
        active = active & (path < last)
    # Joining in a kernel of its own keeps all SIMD lanes busy.
    dr.eval(kept.records, camera)
    sums = [dr.zeros(mi.Float, dr.width(fiber)) for _ in range(light.nodes)]
    for k in range(paths):
        chosen = kept.read(k)
        numbers = stream.event(mi.UInt32(k * LIGHT_EVENTS + LIGHT_EVENTS - 1))
        found = chosen.share * joined_light(
            scene, chosen, camera, numbers, chosen.share > 0, aim, bridge
        )
        weights = light.weights(fiber, chosen.o, chosen.d)
        for j in range(light.nodes):
            sums[j] += found * weights[j]
    return [value / mi.Float(last) for value in sums]


@dr.syntax
def joined_light(
    scene: Any, picked: Picked, camera: CameraSubpath, numbers: Any, active: Any, aim: Aim,
    bridge: Bridge,
) -> Any:  # fmt: skip
    """Return the light of the picked vertex over all joins."""
    y = picked.vertex
    smooth = active & (y.volume | y.diffuse)
    # A bridge could have found this glossy vertex from the smooth one before it.
    by_bridge = mi.Float(0.0)
    if active & ~smooth & picked.before_smooth:
        by_bridge = y.vcm * bridge.area_density(camera.facet.p, y.p, y.n, picked.before)
    light = _total(join(scene, y, camera.facet, active, aim, extra=by_bridge))
    by_bridge = mi.Float(0.0)
    if smooth & camera.glossy_bridged:
        by_bridge = camera.glossy.vcm * bridge.area_density(
            camera.facet.p, camera.glossy.p, camera.glossy.n, y.p
        )
    light += _total(join(scene, y, camera.glossy, active, aim, extra=by_bridge))
    light += _total(join(scene, y, camera.end, active, aim, bridged=camera.end_bridged))
    light += _total(bridge.join(scene, y, camera.facet, numbers[0], numbers[1], smooth, aim))
    return light


def _total(value: Any) -> Any:
    return dr.mean(value)
