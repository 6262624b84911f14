"""Joins of camera subpaths to light subpaths of the film sampler, after both have been traced.

Light subpaths are long, joins cost ray casts, and which pair of vertices carries light is mostly
chance. So every light subpath leaves a few vertices (``render.film_light``), every camera subpath
looks at those of many light subpaths, glimpses (``render.film_glimpse``) leave a few of them, and
for each kept camera vertex one of these is drawn by its promise (``render.film_promise``) and
stands for all: connections to a cache of light vertices (Davidovic et al. 2014, "Progressive light
transport simulation on the GPU") that are resampled (Popov et al. 2015, "Probabilistic connections
for bidirectional path tracing").
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from render.connect import join
from render.film_bridge import Mirrors, bridge, competing
from render.film_camera import CameraPart, Kept
from render.film_ensemble import Ensemble
from render.film_glimpse import Look, Seen, glimpse
from render.film_light import LightVertex, LightVertices, seen_from
from render.film_paths import SPARE, Limits
from render.film_promise import mirrored, promise
from render.lane_memory import stacked, taken
from render.primary import Stream
from render.vertex import PASSED

# Light vertices that are glimpsed for each that is promised.
GLIMPSED = 16


@dataclass
class Drawn:
    """The light vertex drawn for one camera vertex: its place, its promise, and that of all.

    By itself it stands for ``share`` vertices. Bridges have a mirror too, which was drawn with
    probability ``chance``. A Dr.Jit PyTree.
    """

    place: Any
    share: Any
    hope: Any
    total: Any
    mirror: Any
    chance: Any

    @staticmethod
    def none() -> Drawn:
        """Return none yet."""
        share, hope, total, chance = (mi.Float(0.0) for _ in range(4))
        return Drawn(mi.UInt32(0), share, hope, total, mi.UInt32(0), chance)

    def offered(
        self, place: Any, share: Any, hope: Any, number: Any, mirror: Any = 0, chance: Any = 0.0
    ) -> Drawn:
        """Return this, or the vertex at ``place`` with probability by its ``hope``."""
        total = self.total + hope
        chosen = (hope > 0) & (number * total < hope)
        return Drawn(
            dr.select(chosen, place, self.place),
            dr.select(chosen, share, self.share),
            dr.select(chosen, hope, self.hope),
            total,
            dr.select(chosen, mirror, self.mirror),
            dr.select(chosen, chance, self.chance),
        )

    def all(self) -> Any:
        """Return how many vertices the drawn one stands for; 0 where there is none."""
        there = self.hope > 0
        return dr.select(there, self.share * self.total / self.hope, 0.0)


@dr.syntax
def joins(
    scene: Any, camera: CameraPart, light: LightVertices, ensemble: Ensemble, stream: Stream,
    limits: Limits, mirrors: Mirrors | None, shared: bool,
) -> Any:  # fmt: skip
    """Return the light that each lane's camera subpath gets from its partners, their average.

    Where partners are ``shared``, only one of every ``GLIMPSED`` of their vertices is promised to a
    camera vertex, drawn by a glimpse of all.
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
    last, number = paths * slots, dr.zeros(mi.UInt32, lanes)
    while number < last:
        near, far = [Drawn.none() for _ in ends], Drawn.none()
        until = dr.minimum(number + glimpsed, last)
        while number < until:
            k = number // slots
            place = (number - k * slots) * ensemble.lanes + partner_of(lane, k)
            y = taken(seen, place)
            numbers = stream.event(3 * SPARE + number)
            for i in range(len(ends)):
                fits = looks[i].there & (y.edges + looks[i].edges < most)
                hope = dr.select(fits, glimpse(y, looks[i]), 0.0)
                near[i] = near[i].offered(place, 1.0, hope, numbers[i])
            if mirrors is not None:
                hope = dr.select(y.smooth & (y.edges + anchor.edges + 1 < most), y.power, 0.0)
                far = far.offered(place, 1.0, hope, numbers[3])
            number += 1
        numbers = stream.event(4 * SPARE + number)
        for i in range(len(ends)):
            share = near[i].all() * dr.gather(mi.Float, shares, near[i].place)
            y = taken(vertices, near[i].place, share > 0)
            hope = share * promise(
                scene, seen_from(y.vertex, ends[i].closed), ends[i].vertex, share > 0
            )
            drawn[i] = drawn[i].offered(near[i].place, share, hope, numbers[i])
        if mirrors is not None:
            share = far.all() * dr.gather(mi.Float, shares, far.place)
            y = taken(vertices, far.place, share > 0)
            pick = stream.event(5 * SPARE + number)[0]
            mirror, chance = mirrors.drawn(anchor.vertex.p, y.vertex.p, pick)
            hope = mirrored(scene, mirrors, y.vertex, anchor.vertex, mirror, chance, share > 0)
            over = over.offered(far.place, share, share * hope, numbers[3], mirror, chance)
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
            scene, mirrors, seen_from(y.vertex, anchor.closed), anchor.vertex, over.mirror,
            over.chance, (u, v), share > 0,
        ) * share  # fmt: skip
    return joined / mi.Float(paths)


def _join(scene: Any, mirrors: Mirrors | None, y: LightVertex, end: Kept, active: Any) -> Any:
    """Return the light of ``y`` at a kept camera vertex."""
    z = end.vertex
    further = competing(mirrors, y.vertex, y.trail, z, end.before, end.waiting, active)
    return join(scene, seen_from(y.vertex, end.closed), z, active, extra=further, passed=PASSED)
