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

from dataclasses import replace

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
    SubpathTracer,
    SubpathVertex,
    lens_seen_from,
)
from render.integrators.vertex_cache import LightVertexCache, MortonNeighbors
from render.paths.connect import connection_contribution, optical_depth
from render.paths.mirrors import mirror_ratio
from render.paths.records import DrawnRecords
from render.paths.vertex import VOLUME_PASSES, channel_mean, for_camera_passes
from render.sampling.reservoirs import OneNumberReservoir, Reservoir
from render.sampling.streams import Stream

LENS = MIRROR_END + 1
"""The lens among what camera subpaths keep for connections."""
PROJECTION_WEIGHT = 0.25
"""What connecting a light vertex to the camera counts for, relative to connections of lanes that
share vertices: many light subpaths are looked at for one that is projected."""
PROXY_COUNT = 16
"""Light vertices whose proxy weights are compared for one target weight."""
NEIGHBOR_COUNT = 12
"""Vertices close to the main camera vertex whose proxy weights are compared."""
NEIGHBOR_ENDS = 2
"""Camera vertices, first the main one, that look at the close ones."""


class Partners:
    """What camera subpaths are connected to, and what both know of the scene.

    Where partners are ``shared``, only one of every ``PROXY_COUNT`` of their vertices gets a target
    weight for a camera vertex, drawn by the proxy weights of all; and vertices close to the main
    camera vertex are drawn from the whole group instead. That is round ``rounds``; round
    ``final`` connects.
    """

    def __init__(
        self, tracer: SubpathTracer, kept: DrawnRecords, cache: LightVertexCache, stream: Stream,
        boxes: MediumBoxes, shared: bool, aperture: mi.Point2f,
    ) -> None:  # fmt: skip
        """``kept`` are the camera subpaths' vertices (``render.integrators.subpaths.MAIN``).

        ``aperture`` is where on the lens each lane's light vertex is seen.
        """
        self.emission, self.mirrors, self.boxes = tracer.emission, tracer.mirrors, boxes
        self.kept, self.cache, self.stream = kept, cache, stream
        self.sensor, self.aperture = tracer.sensor, aperture
        self.lens_weight = PROJECTION_WEIGHT if shared else 1.0
        self.edges_max = tracer.limits.edges()
        count, per_round = cache.groups.path_count * cache.slots, PROXY_COUNT if shared else 1
        self.count, self.per_round, self.rounds = (
            dr.opaque(mi.UInt32, n) for n in (count, per_round, -(-count // per_round))
        )
        self.final = self.rounds + int(shared)
        main = self.end(mi.UInt32(MAIN))[0].vertex.p
        self.neighbors = MortonNeighbors(cache.proxies, cache.groups, main) if shared else None

    def end(self, k: mi.UInt32) -> tuple[SubpathVertex, LightCandidate]:
        """Return the ``k``-th kept vertex of each lane's camera subpath, none for the ``LENS``.

        And the light vertex that was drawn for the lens, none for the others.
        """
        lens, lanes = k == LENS, self.cache.groups
        lane = lanes.lane + dr.select(lens, lanes.lanes, 0)
        row, weight = self.kept.drawn(lane, dr.select(lens, self.cache.slots, k))
        found: SubpathVertex = self.kept.packed.gather(row, ~lens & (weight > 0))
        found.vertex.weight = dr.select(lens, 0.0, weight)
        light = LightCandidate.none()
        light.row, light.represented = row, dr.select(lens, weight, 0.0)
        return found, light

    def lens(self, kept: SubpathVertex, light: LightCandidate) -> SubpathVertex:
        """Return the place on the lens that sees ``light``, in fields like those of ``kept``.

        ``uv`` is where on the film; ``beta`` the importance.
        """
        active = light.represented > 0
        y = self.cache.vertex(light.row, active).vertex
        ds, importance, active = lens_seen_from(self.sensor, y, self.aperture, active)
        # The near clipping plane hides all that is before it.
        near = self.sensor.near_clip() / dr.select(active, -dr.dot(ds.d, ds.n), 1.0)
        vertex = replace(
            kept.vertex, p=mi.Point3f(ds.p - near * ds.d), uv=ds.uv, beta=importance,
            weight=dr.select(active, mi.Float(1.0), 0.0),
        )  # fmt: skip
        passes = mi.UInt32(VOLUME_PASSES) if self.emission.media else kept.passes
        return replace(kept, vertex=vertex, passes=passes)


@dr.syntax
def connect_subpaths(partners: Partners) -> tuple[mi.Spectrum, mi.Spectrum, mi.Point2f]:
    """Return the light that each lane's camera subpath gets from its partners, their average.

    And what its light subpath sends to the lens (t = 1), and where on the film. For each camera
    vertex and the lens this is one loop over rounds of draws, the last of which connects: what is
    written once is compiled once.
    """
    total, projected, where = mi.Spectrum(0.0), mi.Spectrum(0.0), mi.Point2f(0.0)
    end = mi.UInt32(MAIN)
    while end <= LENS:
        kept, drawn = partners.end(end)
        lens = end == LENS
        if lens:
            kept = partners.lens(kept, drawn)
        light = _connect_end(partners, kept, drawn, end)
        total += dr.select(lens, 0.0, light)
        projected = dr.select(lens, light, projected)
        where = dr.select(lens, kept.vertex.uv, where)
        end += dr.select(end == GLOSSY, LENS - GLOSSY, 1)
    if partners.mirrors is not None:
        total += _connect_over_mirrors(partners, partners.mirrors)
    return total / mi.Float(partners.cache.groups.paths), projected, where


@dr.syntax
def _connect_end(
    partners: Partners, kept: SubpathVertex, first: LightCandidate, end: mi.UInt32
) -> mi.Spectrum:
    """Return the light that ``kept``, the vertex number ``end`` of each lane, gets.

    From one that target weights draw, or from the ``first`` one, that of the lens.
    """
    light, lens = mi.Spectrum(0.0), end == LENS
    drawn = Reservoir.holding(first)
    drawn.weight = drawn.total = dr.select(lens, mi.Float(1.0), 0.0)
    step = dr.select(lens, partners.final, 0)
    look = CameraProxy.of(kept)
    # What a loop does not change is no part of its state: to find that, it is traced twice.
    while dr.hint(look.valid & (step <= partners.final), exclude=[kept, end, look, lens]):
        u, offset, number, _ = partners.stream.event((3 + end) * EVENT_BLOCK + step)
        few = OneNumberReservoir.drawing(mi.UInt32(0), u)
        few = _by_proxy_weights(partners, look, few, step, offset, end < NEIGHBOR_ENDS)
        row, represented = partners.cache.drawn(few.item)
        stands = few.contribution_weight() * represented
        candidate = LightCandidate(row, stands, mi.UInt32(0), mi.Float(0.0))
        connects = step == partners.final
        candidate = dr.select(connects, drawn.item, candidate)
        weight = drawn.contribution_weight(drawn.item.represented)
        weight = dr.select(connects, weight, stands)
        sent = weight * _connected(partners, candidate.row, kept, weight > 0, connects, lens)
        light += dr.select(connects, sent, 0.0)
        drawn = drawn.update(candidate, dr.select(connects, 0.0, channel_mean(sent)), number)
        step += 1
    return light


@dr.syntax
def _by_proxy_weights(
    partners: Partners, look: CameraProxy, few: OneNumberReservoir, step: mi.UInt32,
    offset: mi.Float, looks_near: mi.Bool,
) -> OneNumberReservoir:  # fmt: skip
    """Return ``few`` after the light vertices of round ``step``, which a vertex ``looks`` at."""
    near = step == partners.rounds
    number = dr.select(near, 0, step * partners.per_round)
    until = dr.minimum(number + partners.per_round, partners.count)
    until = dr.select(near, dr.select(looks_near, NEIGHBOR_COUNT, 0), until)
    while dr.hint(number < until, exclude=[look, near, until, offset, looks_near]):
        index, represented = _light_vertex(partners, number, near, offset, looks_near)
        y = partners.cache.proxies.gather(index)
        fits = (y.edges + look.edges < partners.edges_max) & (represented > 0)
        weight = dr.select(fits, proxy_weight(y, look), 0.0)
        few = few.offered(index, weight, weight * represented)
        number += 1
    return few


@dr.syntax
def _light_vertex(
    partners: Partners, number: mi.UInt32, near: mi.Bool, offset: mi.Float, looks_near: mi.Bool
) -> tuple[mi.UInt32, mi.Float]:
    """Return the index of the ``number``-th vertex of all or of those ``near``.

    And how many it represents; a uniform ``offset`` spreads those near evenly.
    """
    neighbors = partners.neighbors
    index, represented = partners.cache.index(number), mi.Float(1.0)
    if neighbors is not None:
        if near:
            place = (mi.Float(number) + offset) / NEIGHBOR_COUNT
            index, represented = neighbors.sample(place, NEIGHBOR_COUNT)
        elif looks_near:
            represented = dr.select(neighbors.holds(index), 0.0, 1.0)
    return index, represented


@dr.syntax
def _connected(
    partners: Partners, row: mi.UInt32, kept: SubpathVertex, active: mi.Bool, connects: mi.Bool,
    lens: mi.Bool,
) -> mi.Spectrum:  # fmt: skip
    """Return the light that a kept camera vertex gets from the light vertex at ``row``.

    What is in the way is looked for where it ``connects``; else this is for a target weight.
    """
    light, emission = partners.cache.vertex(row, active), partners.emission
    z, y = kept.vertex, for_camera_passes(light.vertex, kept.passes)
    transmittance, further = mi.Spectrum(1.0), mi.Float(0.0)
    if connects:
        depth, clear = optical_depth(emission.scene, y, z, active, emission.nulls)
        transmittance = dr.select(clear, dr.exp(-depth), 0.0)
        further = mirror_ratio(partners.mirrors, light, kept, active, GLOSSY_WEIGHT)
    else:
        transmittance = mi.Spectrum(partners.boxes.transmittance(y, z.p, active))
    counted = (lens, partners.lens_weight)
    return z.weight * connection_contribution(
        y, z, transmittance, active, extra=further, glossy=GLOSSY_WEIGHT, lens=counted
    )


@dr.syntax
def _connect_over_mirrors(partners: Partners, mirrors: MirrorSet) -> mi.Spectrum:
    """Return the light that each lane's camera subpath gets over mirrors, summed over partners."""
    cache, stream = partners.cache, partners.stream
    kept = partners.end(mi.UInt32(MIRROR_END))[0]
    end = kept.vertex
    here = end.weight > 0
    mirrored = Reservoir.holding(LightCandidate.none())
    last, number = partners.count, mi.UInt32(0)
    first = cache.proxies.gather(cache.index(number))
    image = mirrors.likely_image(end.p, first.p)  # in the mirror that proxy weights know
    while here & (number < last):
        u, pick, w, _ = stream.event((3 + MIRROR_END) * EVENT_BLOCK + number)
        few = OneNumberReservoir.drawing(mi.UInt32(0), u)
        until = dr.minimum(number + partners.per_round, last)
        while number < until:
            index = cache.index(number)
            y = cache.proxies.gather(index)
            fits = y.wide & (y.edges + kept.edges + 1 < partners.edges_max)
            weight = mirrored_proxy_weight(y, end.p, image, mirrors.blur)
            few = few.offered(index, dr.select(fits, weight, 0.0))
            number += 1
        row, represented = cache.drawn(few.item)
        stands = few.contribution_weight() * represented
        light = cache.vertex(row, stands > 0)
        mirror, probability = mirrors.select(end.p, light.vertex.p, pick)
        weight = mirrored_target_weight(
            partners.boxes, mirrors, light.vertex, end, mirror, probability, stands > 0
        )
        candidate = LightCandidate(row, stands, mirror, probability)
        mirrored = mirrored.update(candidate, stands * weight, w)
    chosen = mirrored.item
    weight = mirrored.contribution_weight(chosen.represented)
    light = cache.vertex(chosen.row, weight > 0)
    u, w, _, _ = stream.event(mi.UInt32(EVENT_BLOCK))
    return weight * mirrors.connect(
        partners.emission.scene, for_camera_passes(light.vertex, kept.passes), end,
        chosen.mirror, chosen.probability, (u, w), weight > 0,
    )  # fmt: skip
