"""Camera subpaths of the film sampler: what they find alone, and what they keep for joins."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from render.integrators.emitters import Emission
from render.integrators.mirror_connections import Mirrors, Trail, counted
from render.integrators.path_limits import EVENTS, SPARE, PathLimits, survive
from render.paths.vertex import PASSES, Vertex, choose, empty_vertex, is_smooth, left_after
from render.paths.walk import advance, bounce, start
from render.sampling.streams import Stream

# How much less often bridges start from a smooth vertex behind another one.
LATER = 0.5
# How much less often the glossy vertex that the lens sees is kept than one behind it.
FIRST = 0.3


@dataclass
class Kept:
    """A camera vertex for joins, behind ``edges`` edges (a Dr.Jit PyTree).

    ``before`` is the point before it; ``waiting`` says that it is glossy after a smooth vertex,
    ``left`` how many volume vertices the camera subpath may still pass behind it.
    """

    vertex: Vertex
    edges: Any
    before: Any
    waiting: Any
    left: Any

    @staticmethod
    def empty() -> Kept:
        """Return one of weight 0."""
        none = mi.Bool(False)
        return Kept(empty_vertex(), mi.UInt32(0), dr.zeros(mi.Point3f), none, mi.UInt32(0))

    def replaced(self, condition: Any, v: Vertex, edges: Any, trail: Trail, left: Any) -> Kept:
        """Return ``v``, which ends ``trail``, where ``condition`` holds; else this."""
        return Kept(
            choose(condition, v, self.vertex),
            dr.select(condition, edges, self.edges),
            dr.select(condition, trail.before, self.before),
            dr.select(condition, trail.waiting, self.waiting),
            dr.select(condition, left, self.left),
        )


@dataclass
class CameraPart:
    """What a camera subpath found by itself, and the vertices that it keeps for joins.

    ``main`` is the first smooth vertex, ``later`` one of the other smooth ones, ``glossy`` one of
    the glossy ones, ``anchor`` the smooth vertex that bridges start from.
    """

    radiance: Any
    main: Kept
    later: Kept
    glossy: Kept
    anchor: Kept


@dr.syntax
def camera_part(
    scene: Any, emission: Emission, ray: Any, medium: Any, density: Any, beta: Any,
    stream: Stream, limits: PathLimits, mirrors: Mirrors | None, projected: float,
) -> CameraPart:  # fmt: skip
    """Trace camera subpaths along ``ray``, which was drawn with ``density`` per solid angle.

    Light vertices that are projected onto the film count ``projected`` times as much as joins.
    """
    main, later, glossy, anchor = (Kept.empty() for _ in range(4))
    trail = Trail.empty()
    laters, glossies = mi.Float(0.0), mi.Float(0.0)
    starts, of_anchor, of_glossy = mi.Float(0.0), mi.Float(1.0), mi.Float(1.0)
    radiance = mi.Spectrum(0.0)
    most, roulette = limits.edges(), limits.roulette()
    free = stream.event(mi.UInt32(1))[0]
    head = start(ray.o, ray.d, medium, beta, projected * dr.rcp(density), mi.Float(0.0), free)
    left = mi.UInt32(PASSES)
    event, edges = mi.UInt32(2), mi.UInt32(1)
    active = dr.full(mi.Bool, True, dr.width(ray.o))
    while active:
        head, v, arrived, escaped = advance(scene, head, active)
        # Light subpaths of one vertex are not projected: nothing competes with the first hit.
        competing = dr.select(edges == 1, 0.0, v.vcm)
        radiance += emission.seen(v, competing, arrived)
        vcm = counted(mirrors, v, trail, arrived, from_camera=True, first=edges == 1)
        v.terminal = v.terminal & (left == 0)
        left = dr.select(arrived, left_after(v, left), left)
        trail = trail.then(v, arrived)
        v.vcm = vcm
        smooth = arrived & ~v.delta
        spare = stream.event(event + SPARE)
        allowed = smooth & (edges < most)
        radiance += emission.direct(scene, v, spare[0], mi.Point2f(spare[1], spare[2]), allowed)
        # Reservoirs of size 1: one later smooth vertex, a glossy one, one where bridges start.
        wide = smooth & is_smooth(v)
        begins = wide & (main.vertex.weight == 0)
        main = main.replaced(begins, v, edges, trail, left)
        follows, shines = wide & ~begins, smooth & ~wide
        laters += dr.select(follows, 1.0, 0.0)
        dull = dr.select(edges == 1, FIRST, 1.0)
        glossies += dr.select(shines, dull, 0.0)
        later = later.replaced(follows & (spare[3] * laters < 1.0), v, edges, trail, left)
        gleams = shines & (spare[3] * glossies < dull)
        glossy = glossy.replaced(gleams, v, edges, trail, left)
        of_glossy = dr.select(gleams, dull, of_glossy)
        roulette_numbers = stream.event(event + 2 * SPARE)
        likely = dr.select(begins, 1.0, LATER)
        starts += dr.select(wide, likely, 0.0)
        taken = wide & (roulette_numbers[1] * starts < likely)
        anchor = anchor.replaced(taken, v, edges, trail, left)
        of_anchor = dr.select(taken, likely, of_anchor)
        numbers = stream.event(event)
        going = arrived & ~v.terminal & (edges < most)
        head, alive = bounce(head, v, mi.TransportMode.Radiance, numbers, going)
        # Only a smooth face leaves no light subpath that could have been joined here.
        left = dr.select(going & (head.vcm == 0), PASSES, left)
        weight = survive(head.beta, edges, roulette, roulette_numbers[0])
        head.beta = dr.select(alive, head.beta * weight, head.beta)
        alive = alive & (weight > 0)
        active &= ~escaped & (~arrived | (going & alive)) & (event < EVENTS)
        edges += dr.select(arrived, 1, 0)
        event += 1
    later.vertex.weight, glossy.vertex.weight = laters, glossies / of_glossy
    anchor.vertex.weight = starts / of_anchor
    return CameraPart(radiance, main, later, glossy, anchor)
