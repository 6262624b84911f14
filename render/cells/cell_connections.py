"""Joining picked light vertices to camera subpaths: the estimator behind every cell.

A camera subpath sees one facet (``render.cells.facet_subpaths``); each light subpath is represented
by one vertex (``render.cells.light_vertex_picks``). It is joined to every kept vertex of the camera
subpath, directly and over a bridge, with MIS weights over all the ways in which the same path could
have been found (``render.paths.connect.join``).
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from render.cells.facet_subpaths import CameraSubpath
from render.cells.light_vertex_picks import LightPicks, Picked
from render.cells.lower_face_mirror import Bridge
from render.paths.connect import join
from render.paths.vertex import choose, is_smooth
from render.paths.walk import Aim
from render.sampling.proposals import LIGHT_EVENTS


@dr.syntax
def joined_nodes(
    scene: Any, picks: LightPicks, lane: Any, camera: CameraSubpath, stream: Any, offset: Any,
    aim: Aim, bridge: Bridge,
) -> list[Any]:  # fmt: skip
    """Return, per direction node, the radiance that the light picks of ``lane`` send to the camera.

    ``offset`` (uint32) keeps the random numbers of several camera subpaths of one lane apart.
    """
    last = mi.UInt32(picks.paths)
    dr.make_opaque(last)
    sums = [dr.zeros(mi.Float, dr.width(lane)) for _ in picks.weight]
    path = dr.zeros(mi.UInt32, dr.width(lane))
    while path < last:
        picked = picks.memory.read(path, lane)
        numbers = stream.event((path + 1) * LIGHT_EVENTS - 1 - offset)
        found = _joined(scene, picked, camera, numbers, picked.share > 0, aim, bridge)
        for j in range(len(sums)):
            weight = dr.gather(mi.Float, picks.weight[j], picks.memory.index(path, lane))
            sums[j] += found * weight
        path += 1
    return sums


@dr.syntax
def _joined(
    scene: Any, picked: Picked, camera: CameraSubpath, numbers: Any, active: Any, aim: Aim,
    bridge: Bridge,
) -> Any:  # fmt: skip
    """Return the light of the picked vertex over all joins."""
    y = picked.vertex
    smooth = active & is_smooth(y)
    # A bridge could have found this glossy vertex from the smooth one before it.
    by_bridge = mi.Float(0.0)
    if active & ~smooth & picked.before_smooth:
        by_bridge = y.vcm * bridge.area_density(camera.facet.p, y.p, y.n, picked.before)
    light = dr.mean(join(scene, y, camera.facet, active, aim, extra=by_bridge))
    # Little light takes the other joins: each vertex tries one of them.
    to_end = numbers[2] < 0.5
    by_bridge = mi.Float(0.0)
    if smooth & camera.glossy_bridged & ~to_end:
        by_bridge = camera.glossy.vcm * bridge.area_density(
            camera.facet.p, camera.glossy.p, camera.glossy.n, y.p
        )
    other = choose(to_end, camera.end, camera.glossy)
    end_bridged = dr.select(to_end, camera.end_bridged, 0.0)
    light += 2.0 * dr.mean(join(scene, y, other, active, aim, extra=by_bridge, bridged=end_bridged))
    bridged = bridge.join(scene, y, camera.facet, numbers[0], numbers[1], smooth, aim)
    return light + dr.mean(bridged)
