"""Joins of camera subpaths to light subpaths of the film sampler, after both have been traced.

Light subpaths are long, joins cost ray casts, and which pair of vertices carries light is mostly
chance. So every light subpath leaves a few vertices (``render.film_light``), every camera subpath
looks at those of several light subpaths, and for each of its kept vertices one of them all is
drawn by its promise (``render.film_promise``) and stands for the others: connections to a cache of
light vertices (Davidovic et al. 2014, "Progressive light transport simulation on the GPU") that are
resampled (Popov et al. 2015, "Probabilistic connections for bidirectional path tracing").
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from render.connect import join
from render.film_bridge import Mirrors, bridge, competing, is_smooth
from render.film_camera import CameraPart, Kept
from render.film_ensemble import Ensemble
from render.film_light import LightVertex, LightVertices, seen_from
from render.film_paths import SPARE, Limits
from render.film_promise import mirrored, promise
from render.lane_memory import taken
from render.primary import Stream
from render.vertex import PASSED


@dataclass
class Drawn:
    """The light vertex drawn for one camera vertex: its lane and slot there, and its promise.

    ``total`` is the promise of all that were offered (a Dr.Jit PyTree).
    """

    lane: Any
    slot: Any
    hope: Any
    total: Any

    @staticmethod
    def none() -> Drawn:
        """Return none yet."""
        return Drawn(mi.UInt32(0), mi.UInt32(0), mi.Float(0.0), mi.Float(0.0))

    def offered(self, lane: Any, slot: int, hope: Any, number: Any) -> Drawn:
        """Return this, or the vertex in ``slot`` of ``lane`` with probability by its ``hope``."""
        total = self.total + hope
        chosen = (hope > 0) & (number * total < hope)
        return Drawn(
            dr.select(chosen, lane, self.lane), dr.select(chosen, mi.UInt32(slot), self.slot),
            dr.select(chosen, hope, self.hope), total,
        )  # fmt: skip

    def read(self, light: LightVertices) -> tuple[LightVertex, Any]:
        """Return the vertex and how many it stands for; 0 where there is none."""
        there = self.hope > 0
        found, share = LightVertex.empty(), mi.Float(0.0)
        for slot, (pick, pick_share) in enumerate(zip(light.picks, light.shares, strict=True)):
            here = there & (self.slot == slot)
            found = taken(pick, self.lane, here).where(here, found)
            share = dr.select(here, dr.gather(mi.Float, pick_share, self.lane, here), share)
        return found, dr.select(there, share * self.total / self.hope, 0.0)


@dr.syntax
def joins(
    scene: Any, camera: CameraPart, light: LightVertices, ensemble: Ensemble, stream: Stream,
    limits: Limits, mirrors: Mirrors | None,
) -> Any:  # fmt: skip
    """Return the light that each lane's camera subpath gets from its partners, their average."""
    most = limits.edges()
    anchor = camera.anchor
    ends = [camera.main, camera.later, camera.glossy]
    drawn, over = [Drawn.none() for _ in ends], Drawn.none()
    picks, shares, partner_of = light.picks, light.shares, ensemble.partner
    slots, lane, last = len(picks), ensemble.lane, ensemble.paths
    k = dr.zeros(mi.UInt32, dr.width(lane))
    while k < last:
        partner = partner_of(lane, k)
        for slot in range(slots):
            share = dr.gather(mi.Float, shares[slot], partner)
            y = taken(picks[slot], partner, share > 0)
            numbers = stream.event(3 * SPARE + k * slots + slot)
            for i in range(len(ends)):
                hope = share * _hope(scene, y, ends[i], (share > 0), most)
                drawn[i] = drawn[i].offered(partner, slot, hope, numbers[i])
            if mirrors is not None:
                fits = (share > 0) & is_smooth(y.vertex) & (y.edges + anchor.edges + 1 < most)
                hope = share * mirrored(scene, mirrors, y.vertex, anchor.vertex, fits)
                over = over.offered(partner, slot, hope, numbers[3])
        k += 1
    joined: Any = mi.Spectrum(0.0)
    for end, choice in zip(ends, drawn, strict=True):
        y, share = choice.read(light)
        joined += _join(scene, mirrors, y, end, share > 0) * share
    if mirrors is not None:
        y, share = over.read(light)
        seen = seen_from(y.vertex, anchor.closed)
        numbers = stream.event(mi.UInt32(SPARE))
        joined += bridge(scene, mirrors, seen, anchor.vertex, numbers[:3], share > 0) * share
    return joined / mi.Float(last)


def _hope(scene: Any, y: LightVertex, end: Kept, active: Any, most: Any) -> Any:
    active = active & (y.edges + end.edges < most)
    return promise(scene, seen_from(y.vertex, end.closed), end.vertex, active)


def _join(scene: Any, mirrors: Mirrors | None, y: LightVertex, end: Kept, active: Any) -> Any:
    """Return the light of ``y`` at a kept camera vertex."""
    z = end.vertex
    further = competing(mirrors, y.vertex, y.trail, z, end.before, end.waiting, active)
    return join(scene, seen_from(y.vertex, end.closed), z, active, extra=further, passed=PASSED)
