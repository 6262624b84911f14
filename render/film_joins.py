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
from render.lane_memory import stacked, taken
from render.primary import Stream
from render.vertex import PASSED


@dataclass
class Drawn:
    """The light vertex drawn for one camera vertex: its place, its promise, and that of all.

    A Dr.Jit PyTree.
    """

    place: Any
    hope: Any
    total: Any

    @staticmethod
    def none() -> Drawn:
        """Return none yet."""
        return Drawn(mi.UInt32(0), mi.Float(0.0), mi.Float(0.0))

    def offered(self, place: Any, hope: Any, number: Any) -> Drawn:
        """Return this, or the vertex at ``place`` with probability by its ``hope``."""
        total = self.total + hope
        chosen = (hope > 0) & (number * total < hope)
        return Drawn(
            dr.select(chosen, place, self.place), dr.select(chosen, hope, self.hope), total
        )

    def read(self, vertices: LightVertex, shares: Any) -> tuple[LightVertex, Any]:
        """Return the vertex and how many it stands for; 0 where there is none."""
        there = self.hope > 0
        share = dr.gather(mi.Float, shares, self.place, there) * self.total / self.hope
        return taken(vertices, self.place, there), dr.select(there, share, 0.0)


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
    lane, paths, partner_of = ensemble.lane, ensemble.paths, ensemble.partner
    lanes, slots = dr.width(lane), len(light.picks)
    vertices, shares = stacked(light.picks, lanes), stacked(light.shares, lanes)
    last, number = paths * slots, dr.zeros(mi.UInt32, lanes)
    while number < last:
        k = number // slots
        place = (number - k * slots) * ensemble.lanes + partner_of(lane, k)
        share = dr.gather(mi.Float, shares, place)
        y = taken(vertices, place, share > 0)
        numbers = stream.event(3 * SPARE + number)
        for i in range(len(ends)):
            hope = share * _hope(scene, y, ends[i], share > 0, most)
            drawn[i] = drawn[i].offered(place, hope, numbers[i])
        if mirrors is not None:
            fits = (share > 0) & is_smooth(y.vertex) & (y.edges + anchor.edges + 1 < most)
            hope = share * mirrored(scene, mirrors, y.vertex, anchor.vertex, fits)
            over = over.offered(place, hope, numbers[3])
        number += 1
    joined: Any = mi.Spectrum(0.0)
    for end, choice in zip(ends, drawn, strict=True):
        y, share = choice.read(vertices, shares)
        joined += _join(scene, mirrors, y, end, share > 0) * share
    if mirrors is not None:
        y, share = over.read(vertices, shares)
        seen = seen_from(y.vertex, anchor.closed)
        numbers = stream.event(mi.UInt32(SPARE))
        joined += bridge(scene, mirrors, seen, anchor.vertex, numbers[:3], share > 0) * share
    return joined / mi.Float(paths)


def _hope(scene: Any, y: LightVertex, end: Kept, active: Any, most: Any) -> Any:
    active = active & (y.edges + end.edges < most)
    return promise(scene, seen_from(y.vertex, end.closed), end.vertex, active)


def _join(scene: Any, mirrors: Mirrors | None, y: LightVertex, end: Kept, active: Any) -> Any:
    """Return the light of ``y`` at a kept camera vertex."""
    z = end.vertex
    further = competing(mirrors, y.vertex, y.trail, z, end.before, end.waiting, active)
    return join(scene, seen_from(y.vertex, end.closed), z, active, extra=further, passed=PASSED)
