"""Bidirectional paths from fibers to facets: the estimator behind every transport cell.

A camera subpath starts in a pixel of one facet, refracts through the rough lower face and meets
the coating; light subpaths start at one fiber. Every vertex of every light subpath is joined to
the kept vertices of the camera subpath, with MIS weights over all the ways in which the same path
could have been found (``render.connect.join``).

Camera subpaths are absorbed at their first volume vertex and at the second diffuse surface: light
subpaths do the long scattering, so no long path is ever stored. Kept are: ``facet`` (the first
diffuse vertex), ``end`` (where the subpath is absorbed) and one of the glossy vertices between.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from render.bridge import Bridge
from render.chains import LIGHT_EVENTS
from render.connect import join
from render.fiber_light import FiberLight
from render.segments import Aim, advance, bounce, start
from render.vertex import Vertex, choose, empty_vertex

# Events that one subpath may take; what the bound costs is measured in tests/validation.
CAMERA_EVENTS = 16
BRIDGE_EVENT = LIGHT_EVENTS // 2
# Probability that a light vertex is joined to the end of the camera subpath, else to a glossy one.
END_SHARE = 0.7


@dataclass
class CameraSubpath:
    """The kept vertices of a camera subpath (weight 0 where there is none).

    ``glossy_bridged`` says that ``glossy`` follows the facet directly, so that a bridge could
    have found it too; ``end_bridged`` is the density ratio of that for the vertex before ``end``.
    """

    facet: Vertex
    glossy: Vertex
    end: Vertex
    glossy_bridged: Any
    end_bridged: Any


@dr.syntax
def camera_subpath(
    scene: Any, o: Any, d: Any, stream: Any, first: int, aim: Aim, bridge: Bridge
) -> CameraSubpath:
    """Trace camera subpaths from rays ``(o, d)``; takes events of ``stream`` from ``first`` on."""
    facet, glossy, end = empty_vertex(), empty_vertex(), empty_vertex()
    free = stream.event(mi.UInt32(first))[0]
    head = start(o, d, dr.zeros(mi.MediumPtr), mi.Spectrum(1.0), mi.Float(0), mi.Float(0), free)
    event = mi.UInt32(first + 1)
    active = dr.full(mi.Bool, True, dr.width(o))
    seen = mi.Bool(False)
    glossies = mi.Float(0.0)
    glossy_bridged, end_bridged = mi.Bool(False), mi.Float(0.0)
    # Of the vertex before: whether it is the first glossy one after the facet, and where it is.
    follows, before, before_n, before_vcm = (
        mi.Bool(False), dr.zeros(mi.Point3f), dr.zeros(mi.Normal3f), mi.Float(0.0)
    )  # fmt: skip
    while active:
        head, v, arrived, escaped = advance(scene, head, active)
        v.terminal = v.terminal | (v.diffuse & seen)
        # Up to the facet only one strategy exists: there are no sums to carry.
        v.vcm = dr.select(seen, v.vcm, 0.0)
        v.vc = dr.select(seen, v.vc, 0.0)
        absorbed = arrived & v.terminal
        end = choose(absorbed, v, end)
        is_facet = arrived & v.diffuse & ~seen
        facet = choose(is_facet, v, facet)
        # Reservoir of size 1: every glossy vertex is kept with the same probability.
        is_glossy = arrived & seen & ~v.terminal & ~v.delta & ~v.diffuse
        glossies += dr.select(is_glossy, 1.0, 0.0)
        spare = stream.event(event + CAMERA_EVENTS)[0]
        kept = is_glossy & (spare * glossies < 1.0)
        glossy = choose(kept, v, glossy)
        direct = is_glossy & (glossies == 1.0)
        glossy_bridged = dr.select(kept, direct, glossy_bridged)
        if absorbed & follows:
            end_bridged = before_vcm * bridge.area_density(facet.p, before, before_n, v.p)
        follows = dr.select(arrived, direct, follows)
        before = dr.select(arrived, v.p, before)
        before_n = dr.select(arrived, v.n, before_n)
        before_vcm = dr.select(arrived, v.vcm, before_vcm)
        seen |= is_facet
        going = arrived & ~absorbed
        head, alive = bounce(head, v, mi.TransportMode.Radiance, stream.event(event), going, aim)
        active &= ~escaped & ~absorbed & (~arrived | alive) & (event < first + CAMERA_EVENTS)
        event += 1
    glossy.weight = glossies
    return CameraSubpath(facet, glossy, end, glossy_bridged, end_bridged)


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
) -> list[Any]:
    """Return, per direction node, the mean over ``paths`` light subpaths of the joined radiance.

    One loop runs all light subpaths of a lane one after the other, which keeps SIMD lanes busy:
    sums of many path lengths differ less than single ones.
    """
    last = mi.UInt32(paths)
    dr.make_opaque(last)
    sums = [dr.zeros(mi.Float, dr.width(fiber)) for _ in range(light.nodes)]
    collected = mi.Float(0.0)
    path, event = mi.UInt32(0), mi.UInt32(0)
    o, d = dr.zeros(mi.Point3f), mi.Vector3f(0, 0, 1)
    head = start(
        o, d, dr.zeros(mi.MediumPtr), mi.Spectrum(1.0), mi.Float(0), mi.Float(0), mi.Float(0.5)
    )
    before, before_smooth = dr.zeros(mi.Point3f), mi.Bool(False)
    fresh = dr.full(mi.Bool, True, dr.width(fiber))
    active = mi.Bool(fresh)
    while active:
        if fresh:
            pick_node, u, v_angle, free = stream.event(path * LIGHT_EVENTS)
            x, y, _, _ = stream.event(path * LIGHT_EVENTS + 1)
            o, d = light.sample(fiber, pick_node, (u, v_angle), mi.Point2f(x, y))
            # Light comes from outside the scene's surfaces: joining to the fiber end itself, or
            # hitting it by chance, are no strategies here, hence both sums start at 0.
            head = start(
                o, d, dr.zeros(mi.MediumPtr), mi.Spectrum(1.0), mi.Float(0), mi.Float(0), free
            )
            event = path * LIGHT_EVENTS + 2
            before_smooth = mi.Bool(False)
        head, v, arrived, escaped = advance(scene, head, active)
        v.terminal = v.terminal | v.diffuse
        joined = arrived & ~v.delta
        smooth = arrived & (v.volume | v.diffuse)
        # A bridge could have found this glossy vertex from the smooth one before it.
        found = joined & ~smooth & before_smooth
        by_bridge = mi.Float(0.0)
        if found:
            by_bridge = v.vcm * bridge.area_density(camera.facet.p, v.p, v.n, before)
        collected += _total(join(scene, v, camera.facet, joined, aim, extra=by_bridge))
        # Little light takes the other two joins: each vertex tries one of them.
        number = stream.event(event + BRIDGE_EVENT)
        other = choose(number[2] < END_SHARE, camera.end, camera.glossy)
        to_end = number[2] < END_SHARE
        rarity = dr.select(to_end, 1.0 / END_SHARE, 1.0 / (1.0 - END_SHARE))
        by_bridge = mi.Float(0.0)
        if smooth & camera.glossy_bridged & ~to_end:
            by_bridge = camera.glossy.vcm * bridge.area_density(
                camera.facet.p, camera.glossy.p, camera.glossy.n, v.p
            )
        bridged = dr.select(to_end, camera.end_bridged, 0.0)
        collected += rarity * _total(
            join(scene, v, other, joined, extra=by_bridge, bridged=bridged)
        )
        collected += _total(bridge.join(scene, v, camera.facet, number[0], number[1], smooth, aim))
        before = dr.select(arrived, v.p, before)
        before_smooth = dr.select(arrived, smooth, before_smooth)
        head, alive = bounce(head, v, mi.TransportMode.Importance, stream.event(event), arrived)
        event += 1
        cut = event >= path * LIGHT_EVENTS + BRIDGE_EVENT
        fresh = active & (escaped | (arrived & ~alive) | cut)
        if fresh:
            weights = light.weights(fiber, o, d)
            for j in range(light.nodes):
                sums[j] += collected * weights[j]
            collected = mi.Float(0.0)
            path += 1
        active = active & (path < last)
    return [value / mi.Float(last) for value in sums]


def _total(value: Any) -> Any:
    return dr.mean(value)
