"""Connections of camera subpaths to light subpaths of the film sampler, after both are traced.

Light subpaths are long, connections cost ray casts, and which pair of vertices carries light is
mostly chance. So every light subpath leaves a few vertices (``render.integrators.subpaths``), every
camera subpath looks at those of many light subpaths and at some close to it
(``render.integrators.vertex_cache``), proxy weights leave a few of them, and for each kept camera
vertex one of these is drawn by its target weight and stands for all
(``render.integrators.resampling``): connections to a cache of light vertices (Davidovic et al.
2014, "Progressive light transport simulation on the GPU") that are resampled (Popov et al. 2015,
"Probabilistic connections for bidirectional path tracing").
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi

from render.integrators.medium_boxes import MediumBoxes
from render.integrators.mirror_connections import GLOSSY_WEIGHT, MirrorSet
from render.integrators.resampling import (
    CameraProxy,
    LightCandidate,
    PackedProxies,
    mirrored_proxy_weight,
    mirrored_target_weight,
    proxy_weight,
    target_weight,
)
from render.integrators.subpaths import (
    EVENT_BLOCK,
    CameraSubpath,
    CameraVertex,
    LightVertex,
    PathLimits,
)
from render.integrators.vertex_cache import LightVertexCache, MortonNeighbors
from render.paths.connect import connect_vertices
from render.paths.mirrors import mirror_ratio
from render.paths.vertex import for_camera_passes
from render.sampling.reservoirs import OneNumberReservoir, Reservoir
from render.sampling.streams import Numbers, Stream

PROXY_COUNT = 16
"""Light vertices whose proxy weights are compared for one target weight."""
NEIGHBOR_COUNT = 12
"""Vertices close to the main camera vertex whose proxy weights are compared."""
NEIGHBOR_ENDS = 2
"""Camera vertices, first the main one, that look at the close ones."""


@dr.syntax
def connect_subpaths(
    scene: mi.Scene, camera: CameraSubpath, cache: LightVertexCache, stream: Stream,
    limits: PathLimits, mirrors: MirrorSet | None, boxes: MediumBoxes, shared: bool,
) -> mi.Spectrum:  # fmt: skip
    """Return the light that each lane's camera subpath gets from its partners, their average.

    Where partners are ``shared``, only one of every ``PROXY_COUNT`` of their vertices gets a target
    weight for a camera vertex, drawn by the proxy weights of all; and vertices close to the main
    camera vertex are drawn from the whole group instead.
    """
    # ----------------------------- Configure loop state ------------------------------
    proxies_per_target = mi.UInt32(PROXY_COUNT if shared else 1)
    dr.make_opaque(proxies_per_target)
    edges_max = limits.edges()
    mirror_end = camera.mirror_end
    ends = [camera.main, camera.later, camera.glossy]
    looks = [CameraProxy.of(end) for end in ends]
    drawn = [Reservoir.holding(LightCandidate.none()) for _ in ends]  # by target weights
    mirrored = Reservoir.holding(LightCandidate.none())
    paths, lanes = cache.groups.paths, dr.width(cache.groups.lane)
    packed = PackedProxies(cache.proxies)
    neighbors = (
        MortonNeighbors(cache.proxies, cache.groups, camera.main.vertex.p) if shared else None
    )
    image = mirror_end.vertex.p  # in the mirror that proxy weights know
    if mirrors is not None:
        first = packed.gather(cache.index(dr.zeros(mi.UInt32, lanes)))
        image = mirrors.likely_image(mirror_end.vertex.p, first.p)
    last, number = paths * cache.slots, dr.zeros(mi.UInt32, lanes)  # vertices of all partners
    while number < last:
        # --------------- Proxy weights: one of a few, for each end --------------------
        numbers = stream.event(3 * EVENT_BLOCK + number)
        few = [OneNumberReservoir.drawing(mi.UInt32(0), u) for u in numbers[: len(ends)]]
        few_mirrored = OneNumberReservoir.drawing(mi.UInt32(0), numbers[3])
        until = dr.minimum(number + proxies_per_target, last)
        while number < until:
            index = cache.index(number)
            y = packed.gather(index)
            close = mi.Bool(False) if neighbors is None else neighbors.holds(index)
            for i in range(len(ends)):
                fits = looks[i].valid & (y.edges + looks[i].edges < edges_max)
                if i < NEIGHBOR_ENDS:
                    fits &= ~close
                weight = dr.select(fits, proxy_weight(y, looks[i]), 0.0)
                few[i] = few[i].offered(index, weight)
            if mirrors is not None:
                fits = y.wide & (y.edges + mirror_end.edges + 1 < edges_max)
                weight = mirrored_proxy_weight(y, mirror_end.vertex.p, image, mirrors.blur)
                few_mirrored = few_mirrored.offered(index, dr.select(fits, weight, 0.0))
            number += 1
        # --------------- Target weights: one of those, for each end -------------------
        numbers = stream.event(4 * EVENT_BLOCK + number)
        drawn = _resampled(boxes, cache, few, ends, drawn, numbers)
        if mirrors is not None:
            index = few_mirrored.item
            represented = few_mirrored.contribution_weight() * dr.gather(
                mi.Float, cache.represented, index
            )
            light = cache.vertex(index, represented > 0)
            pick = stream.event(5 * EVENT_BLOCK + number)[0]
            mirror, probability = mirrors.select(mirror_end.vertex.p, light.vertex.p, pick)
            weight = mirrored_target_weight(
                boxes,
                mirrors,
                light.vertex,
                mirror_end.vertex,
                mirror,
                probability,
                represented > 0,
            )
            candidate = LightCandidate(index, represented, mirror, probability)
            mirrored = mirrored.update(candidate, represented * weight, numbers[3])
    # ------------------------ Close ones, from the whole group -----------------------
    if neighbors is not None:
        numbers = stream.event(mi.UInt32(6 * EVENT_BLOCK))
        few = [OneNumberReservoir.drawing(mi.Int32(0), u) for u in numbers[:NEIGHBOR_ENDS]]
        number, until = dr.zeros(mi.UInt32, lanes), mi.UInt32(NEIGHBOR_COUNT)
        dr.make_opaque(until)
        while number < until:
            y, place, represented = neighbors.sample(
                stream.event(7 * EVENT_BLOCK + number)[0], NEIGHBOR_COUNT
            )
            for i in range(NEIGHBOR_ENDS):
                fits = looks[i].valid & (y.edges + looks[i].edges < edges_max) & (represented > 0)
                weight = dr.select(fits, proxy_weight(y, looks[i]), 0.0)
                few[i] = few[i].offered(place, weight, weight * represented)
            number += 1
        numbers = stream.event(mi.UInt32(8 * EVENT_BLOCK))
        for i in range(NEIGHBOR_ENDS):
            few[i].item = neighbors.index(few[i].item)
        drawn = _resampled(boxes, cache, few, ends, drawn, numbers)
    # ------------------------------ Connect what was drawn ---------------------------
    total = mi.Spectrum(0.0)
    i = mi.UInt32(0)
    while i < len(ends):
        reservoir = _at(i, drawn)
        weight = reservoir.contribution_weight(reservoir.item.represented)
        light = cache.vertex(reservoir.item.index, weight > 0)
        total += _connect(scene, mirrors, light, _at(i, ends), weight > 0) * weight
        i += 1
    if mirrors is not None:
        chosen = mirrored.item
        weight = mirrored.contribution_weight(chosen.represented)
        light = cache.vertex(chosen.index, weight > 0)
        u, v, _, _ = stream.event(mi.UInt32(EVENT_BLOCK))
        total += mirrors.connect(
            scene, for_camera_passes(light.vertex, mirror_end.passes), mirror_end.vertex,
            chosen.mirror, chosen.probability, (u, v), weight > 0,
        ) * weight  # fmt: skip
    return total / mi.Float(paths)


def _at(i: mi.UInt32, items: Sequence[Any]) -> Any:
    """Return the ``i``-th of a few items (Dr.Jit PyTrees), another one in each lane."""
    chosen = items[0]
    for k in range(1, len(items)):
        chosen = dr.select(i == k, items[k], chosen)
    return chosen


@dr.syntax
def _resampled(
    boxes: MediumBoxes, cache: LightVertexCache, few: list[OneNumberReservoir],
    ends: list[CameraVertex], drawn: list[Reservoir], numbers: Numbers,
) -> list[Reservoir]:  # fmt: skip
    """Return ``drawn``, each updated by the light vertex of ``few`` and its target weight.

    A loop, not one copy of the code for each end, which would take LLVM as many times as long.
    """
    i = mi.UInt32(0)
    while i < len(few):
        item, end = _at(i, few), _at(i, ends)
        represented = item.contribution_weight() * dr.gather(mi.Float, cache.represented, item.item)
        y = for_camera_passes(cache.vertex(item.item, represented > 0).vertex, end.passes)
        weight = represented * target_weight(boxes, y, end.vertex, represented > 0)
        candidate = LightCandidate(item.item, represented, mi.UInt32(0), mi.Float(0.0))
        updated = _at(i, drawn).update(candidate, weight, _at(i, numbers))
        for k in range(len(few)):
            drawn[k] = dr.select(i == k, updated, drawn[k])
        i += 1
    return drawn


def _connect(
    scene: mi.Scene, mirrors: MirrorSet | None, y: LightVertex, end: CameraVertex, active: mi.Bool
) -> mi.Spectrum:
    """Return the light of ``y`` at a kept camera vertex."""
    further = mirror_ratio(mirrors, y, end, active, GLOSSY_WEIGHT)
    return connect_vertices(
        scene, for_camera_passes(y.vertex, end.passes), end.vertex, active, extra=further,
        glossy=GLOSSY_WEIGHT,
    )  # fmt: skip
