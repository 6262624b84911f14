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

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from render.integrators.medium_boxes import MediumBoxes
from render.integrators.mirror_connections import GLOSSY_WEIGHT, MirrorSet
from render.integrators.resampling import (
    CameraProxy,
    LightCandidate,
    mirrored_proxy_weight,
    mirrored_target_weight,
    proxy_weight,
)
from render.integrators.subpaths import (
    EVENT_BLOCK,
    GLOSSY,
    MAIN,
    MIRROR_END,
    PathLimits,
    SubpathVertex,
)
from render.integrators.vertex_cache import LightVertexCache, MortonNeighbors
from render.paths.connect import connection_contribution, optical_depth
from render.paths.mirrors import mirror_ratio
from render.paths.records import StackedRecords
from render.paths.vertex import channel_mean, for_camera_passes
from render.sampling.reservoirs import OneNumberReservoir, Reservoir
from render.sampling.streams import Stream

PROXY_COUNT = 16
"""Light vertices whose proxy weights are compared for one target weight."""
NEIGHBOR_COUNT = 12
"""Vertices close to the main camera vertex whose proxy weights are compared."""
NEIGHBOR_ENDS = 2
"""Camera vertices, first the main one, that look at the close ones."""


class Partners:
    """What camera subpaths are connected to, and what both know of the scene."""

    def __init__(
        self, scene: mi.Scene, kept: StackedRecords, cache: LightVertexCache, stream: Stream,
        limits: PathLimits, mirrors: MirrorSet | None, boxes: MediumBoxes,
    ) -> None:  # fmt: skip
        """``kept`` are the camera subpaths' vertices (``render.integrators.subpaths.MAIN``)."""
        self.scene, self.kept, self.cache, self.stream = scene, kept, cache, stream
        self.limits, self.mirrors, self.boxes = limits, mirrors, boxes

    def end(self, k: int | mi.UInt32) -> SubpathVertex:
        """Return the ``k``-th kept vertex of each lane's camera subpath."""
        groups = self.cache.groups
        found: SubpathVertex
        found, found.vertex.weight = self.kept.gather(groups.lane + 2 * k * groups.lanes)
        return found


@dataclass
class Draws:
    """One round of draws for a camera vertex (a Dr.Jit PyTree).

    From the vertices of partners ``first`` to ``until``, or from those ``near``, if the vertex
    ``looks_near`` at all; a uniform ``offset`` spreads these evenly.
    """

    first: mi.UInt32
    until: mi.UInt32
    edges_max: mi.UInt32
    near: mi.Bool
    looks_near: mi.Bool
    offset: mi.Float


@dr.syntax
def connect_subpaths(partners: Partners, shared: bool) -> mi.Spectrum:
    """Return the light that each lane's camera subpath gets from its partners, their average.

    Where partners are ``shared``, only one of every ``PROXY_COUNT`` of their vertices gets a target
    weight for a camera vertex, drawn by the proxy weights of all; and vertices close to the main
    camera vertex are drawn from the whole group instead. For each camera vertex this is one loop
    over rounds of such draws, the last of which connects: what is written once is compiled once.
    """
    cache = partners.cache
    per_round = mi.UInt32(PROXY_COUNT if shared else 1)
    dr.make_opaque(per_round)
    edges_max = partners.limits.edges()
    rounds = (cache.groups.paths * cache.slots + per_round - 1) // per_round
    final = rounds + (1 if shared else 0)  # the round that connects, behind that of close ones
    neighbors = None
    if shared:
        neighbors = MortonNeighbors(cache.proxies, cache.groups, partners.end(MAIN).vertex.p)
    total = mi.Spectrum(0.0)
    end = mi.UInt32(MAIN)
    while end <= GLOSSY:
        kept = partners.end(end)
        drawn = Reservoir.holding(LightCandidate.none())  # by target weights
        step = mi.UInt32(0)
        look = CameraProxy.of(kept)
        while look.valid & (step <= final):
            u, offset, number, _ = partners.stream.event((3 + end) * EVENT_BLOCK + step)
            few = OneNumberReservoir.drawing(mi.UInt32(0), u)
            first = step * per_round
            until = dr.minimum(first + per_round, cache.groups.paths * cache.slots)
            draws = Draws(first, until, edges_max, step == rounds, end < NEIGHBOR_ENDS, offset)
            few = _by_proxy_weights(cache, neighbors, look, few, draws)
            stands = few.contribution_weight() * dr.gather(mi.Float, cache.represented, few.item)
            candidate = LightCandidate(few.item, stands, mi.UInt32(0), mi.Float(0.0))
            connects = step == final
            candidate = dr.select(connects, drawn.item, candidate)
            weight = drawn.contribution_weight(drawn.item.represented)
            weight = dr.select(connects, weight, stands)
            light = weight * _connected(partners, candidate.index, kept, weight > 0, connects)
            total += dr.select(connects, light, 0.0)
            drawn = drawn.update(candidate, dr.select(connects, 0.0, channel_mean(light)), number)
            step += 1
        end += 1
    if partners.mirrors is not None:
        total += _connect_over_mirrors(partners, partners.mirrors, per_round)
    return total / mi.Float(cache.groups.paths)


@dr.syntax
def _by_proxy_weights(
    cache: LightVertexCache, neighbors: MortonNeighbors | None, look: CameraProxy,
    few: OneNumberReservoir, draws: Draws,
) -> OneNumberReservoir:  # fmt: skip
    """Return ``few`` after the light vertices of one round."""
    number = dr.select(draws.near, 0, draws.first)
    close_ones = dr.select(draws.looks_near, NEIGHBOR_COUNT, 0)
    until = dr.select(draws.near, close_ones, draws.until)
    while number < until:
        index, represented = cache.index(number), mi.Float(1.0)
        if neighbors is not None:
            if draws.near:
                place = (mi.Float(number) + draws.offset) / NEIGHBOR_COUNT
                index, represented = neighbors.sample(place, NEIGHBOR_COUNT)
            elif draws.looks_near:
                represented = dr.select(neighbors.holds(index), 0.0, 1.0)
        y = cache.proxies.gather(index)
        fits = (y.edges + look.edges < draws.edges_max) & (represented > 0)
        weight = dr.select(fits, proxy_weight(y, look), 0.0)
        few = few.offered(index, weight, weight * represented)
        number += 1
    return few


@dr.syntax
def _connected(
    partners: Partners, index: mi.UInt32, kept: SubpathVertex, active: mi.Bool, connects: mi.Bool
) -> mi.Spectrum:
    """Return the light that a kept camera vertex gets from the light vertex at ``index``.

    What is in the way is looked for where it ``connects``; else this is for a target weight.
    """
    light = partners.cache.vertex(index, active)
    z, y = kept.vertex, for_camera_passes(light.vertex, kept.passes)
    transmittance, further = mi.Spectrum(1.0), mi.Float(0.0)
    if connects:
        depth, clear = optical_depth(partners.scene, y, z, active)
        transmittance = dr.select(clear, dr.exp(-depth), 0.0)
        further = mirror_ratio(partners.mirrors, light, kept, active, GLOSSY_WEIGHT)
    else:
        transmittance = mi.Spectrum(partners.boxes.transmittance(y, z.p, active))
    return z.weight * connection_contribution(
        y, z, transmittance, active, extra=further, glossy=GLOSSY_WEIGHT
    )


@dr.syntax
def _connect_over_mirrors(
    partners: Partners, mirrors: MirrorSet, per_round: mi.UInt32
) -> mi.Spectrum:
    """Return the light that each lane's camera subpath gets over mirrors, summed over partners."""
    cache, stream = partners.cache, partners.stream
    kept = partners.end(MIRROR_END)
    end, edges_max = kept.vertex, partners.limits.edges()
    here = end.weight > 0
    mirrored = Reservoir.holding(LightCandidate.none())
    last, number = cache.groups.paths * cache.slots, mi.UInt32(0)
    first = cache.proxies.gather(cache.index(number))
    image = mirrors.likely_image(end.p, first.p)  # in the mirror that proxy weights know
    while here & (number < last):
        u, pick, w, _ = stream.event((3 + MIRROR_END) * EVENT_BLOCK + number)
        few = OneNumberReservoir.drawing(mi.UInt32(0), u)
        until = dr.minimum(number + per_round, last)
        while number < until:
            index = cache.index(number)
            y = cache.proxies.gather(index)
            fits = y.wide & (y.edges + kept.edges + 1 < edges_max)
            weight = mirrored_proxy_weight(y, end.p, image, mirrors.blur)
            few = few.offered(index, dr.select(fits, weight, 0.0))
            number += 1
        stands = few.contribution_weight() * dr.gather(mi.Float, cache.represented, few.item)
        light = cache.vertex(few.item, stands > 0)
        mirror, probability = mirrors.select(end.p, light.vertex.p, pick)
        weight = mirrored_target_weight(
            partners.boxes, mirrors, light.vertex, end, mirror, probability, stands > 0
        )
        candidate = LightCandidate(few.item, stands, mirror, probability)
        mirrored = mirrored.update(candidate, stands * weight, w)
    chosen = mirrored.item
    weight = mirrored.contribution_weight(chosen.represented)
    light = cache.vertex(chosen.index, weight > 0)
    u, w, _, _ = stream.event(mi.UInt32(EVENT_BLOCK))
    return weight * mirrors.connect(
        partners.scene, for_camera_passes(light.vertex, kept.passes), end,
        chosen.mirror, chosen.probability, (u, w), weight > 0,
    )  # fmt: skip
