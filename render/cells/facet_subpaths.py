"""Camera subpaths of the cell sampler: from a pixel of one facet to the coating and beyond.

They refract through the rough lower face, meet the coating (the *facet* vertex) and go on until
the second diffuse surface. Volumes end them: light subpaths do the scattering. Kept are the facet,
the *end* on the second diffuse surface (or in a volume that hides the coating) and one of the
glossy vertices between.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from render.cells.lower_face_mirror import Bridge
from render.paths.vertex import Vertex, choose, empty_vertex
from render.paths.walk import Aim, advance, bounce, start

# Events that one subpath may take; what the bound costs is measured in tests/validation.
CAMERA_EVENTS = 16


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
    scene: Any, o: Any, d: Any, stream: Any, first: Any, aim: Aim, bridge: Bridge
) -> CameraSubpath:
    """Trace camera subpaths from rays ``(o, d)``; their events begin at ``first`` (uint32)."""
    facet, glossy, end = empty_vertex(), empty_vertex(), empty_vertex()
    free = stream.event(first)[0]
    head = start(o, d, dr.zeros(mi.MediumPtr), mi.Spectrum(1.0), mi.Float(0), mi.Float(0), free)
    event = first + 1
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
        # A volume behind the facet is left to light subpaths; one before it is what is seen.
        end = choose(absorbed & ~(v.volume & seen), v, end)
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
