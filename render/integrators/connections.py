"""Joins of camera subpaths to light subpaths of the film sampler, after both have been traced.

Light subpaths are long, joins cost ray casts, and which pair of vertices carries light is mostly
chance. So every light subpath leaves a few vertices (``render.integrators.light_subpaths``), every
camera subpath looks at those of many light subpaths and at some close to it
(``render.integrators.neighbors``), glimpses (``render.integrators.proxy_weights``) leave a few of
them, and for each kept camera vertex one of these is drawn by its promise
(``render.integrators.target_weights``) and stands for all: connections to a cache of light vertices
(Davidovic et al. 2014, "Progressive light transport simulation on the GPU") that are resampled
(Popov et al. 2015, "Probabilistic connections for bidirectional path tracing").
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from render.integrators.camera_subpaths import CameraPart, Kept
from render.integrators.light_subpaths import LightVertex, LightVertices, seen_from
from render.integrators.mirror_connections import Mirrors, bridge, competing
from render.integrators.neighbors import Nearby
from render.integrators.path_limits import GLOSSY, SPARE, PathLimits
from render.integrators.proxy_weights import Look, Seen, glimpse
from render.integrators.reservoirs import Drawn, Glimpsed
from render.integrators.target_weights import mirrored, promise
from render.integrators.vertex_cache import Ensemble
from render.paths.connect import join
from render.paths.lane_memory import stacked, taken
from render.sampling.streams import Stream

# Light vertices that are glimpsed for each that is promised.
GLIMPSED = 16
# Vertices close to the main camera vertex that are glimpsed, and how many camera vertices, first
# the main one, look at them.
CLOSE, CLOSE_ENDS = 12, 2


@dr.syntax
def joins(
    scene: Any, camera: CameraPart, light: LightVertices, ensemble: Ensemble, stream: Stream,
    limits: PathLimits, mirrors: Mirrors | None, shared: bool,
) -> Any:  # fmt: skip
    """Return the light that each lane's camera subpath gets from its partners, their average.

    Where partners are ``shared``, only one of every ``GLIMPSED`` of their vertices is promised to a
    camera vertex, drawn by a glimpse of all; and vertices close to the main camera vertex are drawn
    from the whole group instead.
    """
    glimpsed = mi.UInt32(GLIMPSED if shared else 1)
    dr.make_opaque(glimpsed)
    most = limits.edges()
    anchor = camera.anchor
    ends = [camera.main, camera.later, camera.glossy]
    looks = [Look.of(end) for end in ends]
    drawn, over = [Drawn.none() for _ in ends], Drawn.none()
    lane, paths, partner_of = ensemble.lane, ensemble.paths, ensemble.partner
    lanes, slots = dr.width(lane), len(light.picks)
    vertices, shares = stacked(light.picks, lanes), stacked(light.shares, lanes)
    seen = Seen.of(vertices, shares)
    nearby = Nearby(seen, ensemble, camera.main.vertex.p) if shared else None
    last, number = paths * slots, dr.zeros(mi.UInt32, lanes)
    while number < last:
        numbers = stream.event(3 * SPARE + number)
        few, sent = [Glimpsed.none(u) for u in numbers[: len(ends)]], Glimpsed.none(numbers[3])
        until = dr.minimum(number + glimpsed, last)
        while number < until:
            k = number // slots
            place = (number - k * slots) * ensemble.lanes + partner_of(lane, k)
            y = taken(seen, place)
            close = mi.Bool(False) if nearby is None else nearby.holds(place)
            for i in range(len(ends)):
                fits = looks[i].there & (y.edges + looks[i].edges < most)
                if i < CLOSE_ENDS:
                    fits &= ~close
                few[i] = few[i].offered(place, dr.select(fits, glimpse(y, looks[i]), 0.0))
            if mirrors is not None:
                fits = y.smooth & (y.edges + anchor.edges + 1 < most)
                hope = y.power / (dr.squared_norm(y.p - anchor.vertex.p) + mirrors.blur)
                hope = dr.select(fits, hope, 0.0)
                sent = sent.offered(place, hope)
            number += 1
        numbers = stream.event(4 * SPARE + number)
        for i in range(len(ends)):
            drawn[i] = _promised(scene, vertices, shares, few[i], ends[i], drawn[i], numbers[i])
        if mirrors is not None:
            share = sent.all() * dr.gather(mi.Float, shares, sent.place)
            y = taken(vertices, sent.place, share > 0)
            pick = stream.event(5 * SPARE + number)[0]
            mirror, chance = mirrors.drawn(anchor.vertex.p, y.vertex.p, pick)
            hope = mirrored(scene, mirrors, y.vertex, anchor.vertex, mirror, chance, share > 0)
            over = over.offered(sent.place, share, share * hope, numbers[3], mirror, chance)
    if nearby is not None:
        numbers = stream.event(mi.UInt32(6 * SPARE))
        few = [Glimpsed.none(u) for u in numbers[:CLOSE_ENDS]]
        number, until = dr.zeros(mi.UInt32, lanes), mi.UInt32(CLOSE)
        dr.make_opaque(until)
        while number < until:
            y, place, stands_for = nearby.drawn(stream.event(7 * SPARE + number)[0], CLOSE)
            for i in range(CLOSE_ENDS):
                fits = looks[i].there & (y.edges + looks[i].edges < most) & (stands_for > 0)
                hope = dr.select(fits, glimpse(y, looks[i]), 0.0)
                few[i] = few[i].offered(place, hope, stands_for)
            number += 1
        numbers = stream.event(mi.UInt32(8 * SPARE))
        for i in range(CLOSE_ENDS):
            few[i].place = nearby.index(few[i].place)
            drawn[i] = _promised(scene, vertices, shares, few[i], ends[i], drawn[i], numbers[i])
    joined: Any = mi.Spectrum(0.0)
    for end, choice in zip(ends, drawn, strict=True):
        share = choice.all()
        y = taken(vertices, choice.place, share > 0)
        joined += _join(scene, mirrors, y, end, share > 0) * share
    if mirrors is not None:
        share = over.all()
        y = taken(vertices, over.place, share > 0)
        u, v, _, _ = stream.event(mi.UInt32(SPARE))
        joined += bridge(
            scene, mirrors, seen_from(y.vertex, anchor.left), anchor.vertex, over.mirror,
            over.chance, (u, v), share > 0,
        ) * share  # fmt: skip
    return joined / mi.Float(paths)


def _promised(
    scene: Any, vertices: LightVertex, shares: Any, few: Glimpsed, end: Kept, drawn: Drawn,
    number: Any,
) -> Drawn:  # fmt: skip
    """Return ``drawn`` with the light vertex that was drawn by glimpses offered by its promise."""
    share = few.all() * dr.gather(mi.Float, shares, few.place)
    y = taken(vertices, few.place, share > 0)
    hope = share * promise(scene, seen_from(y.vertex, end.left), end.vertex, share > 0)
    return drawn.offered(few.place, share, hope, number)


def _join(scene: Any, mirrors: Mirrors | None, y: LightVertex, end: Kept, active: Any) -> Any:
    """Return the light of ``y`` at a kept camera vertex."""
    z = end.vertex
    further = competing(mirrors, y.vertex, y.trail, z, end.before, end.waiting, active)
    return join(scene, seen_from(y.vertex, end.left), z, active, extra=further, glossy=GLOSSY)
