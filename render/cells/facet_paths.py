"""Camera subpaths of the cell sampler, and their connections: the estimator behind every cell.

Camera subpaths start at a pixel of one facet. They refract through the rough lower face, meet the
coating (the *facet* vertex) and go on until the second diffuse surface. Volumes end them: light
subpaths do the scattering. Only behind smooth faces, where no light vertex can be connected, they
may pass two vertices in volumes, as in pictures (``render.integrators.subpaths``). Kept are the
facet, the *end* on the second diffuse surface (or in a
volume that hides the coating) and one of the glossy vertices between.

Each light subpath is represented by one vertex (``render.cells.light_subpaths``). It is connected
to the kept vertices of the camera subpath, directly and over the mirror in the lower face, with MIS
weights over all the ways in which the same path could have been found (``render.paths.connect``).
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from render.cells.lamp_connections import AIMED_EVENTS, AimedSubpaths, Lamp, MetLamp
from render.cells.light_subpaths import DrawnVertex, DrawnVertices
from render.cells.lower_face_mirror import LowerFaceMirror
from render.cells.mirror_images import ImageChain, MirrorImages
from render.paths.connect import connect_vertices, mirror_connection
from render.paths.mirrors import KeptVertex, SubpathTail, mirror_ratio, shared_d_vcm
from render.paths.vertex import (
    RATIO_MAX,
    VOLUME_PASSES,
    PassableVertex,
    Vertex,
    channel_mean,
    empty_vertex,
    for_camera_passes,
    has_wide_lobe,
    passes_behind,
)
from render.paths.walk import GuidingDistribution, begin_subpath, sample_scattering, trace_segment
from render.sampling.proposals import LIGHT_EVENTS
from render.sampling.reservoirs import Reservoir
from render.sampling.streams import Numbers, Stream

JOINED_STRIDE = 1024
"""Events by which the numbers of vertices that are joined to a lamp are apart."""


@dataclass
class CellVertex(KeptVertex):
    """A camera vertex behind which the subpath may pass so many more volumes (a Dr.Jit PyTree)."""

    passes: mi.UInt32

    @staticmethod
    def none() -> CellVertex:
        """Return one of weight 0."""
        return CellVertex(**vars(KeptVertex.none()), passes=mi.UInt32(0))


@dataclass
class FacetSubpath:
    """The kept vertices of a camera subpath (weight 0 where there is none).

    ``met`` is where the subpath passed through a lamp.
    """

    facet: Vertex
    glossy: CellVertex
    end: CellVertex
    met: MetLamp


@dr.syntax
def trace_facet_subpath(
    scene: mi.Scene, o: mi.Point3f, d: mi.Vector3f, stream: Stream, first: mi.UInt32,
    guiding: GuidingDistribution, mirror: LowerFaceMirror | None, images: MirrorImages | None,
    lamp: Lamp | None, aimed: AimedSubpaths | None, events: int, passable: bool,
) -> FacetSubpath:  # fmt: skip
    """Trace camera subpaths from rays ``(o, d)``; their events begin at ``first``.

    With a ``lamp`` they go on behind the second diffuse surface, until they leave the pad for good.
    ``passable`` says that they pass volumes behind delta faces.
    """
    # --------------------------- Configure loop state ----------------------------
    facet = empty_vertex()  # what is kept, and one of each kind behind it
    glossy, end = (Reservoir.holding(CellVertex.none()) for _ in range(2))
    met = Reservoir.holding(MetLamp.none())
    free = stream.event(first)[0]
    state = begin_subpath(
        o, d, dr.zeros(mi.MediumPtr), mi.Spectrum(1.0), mi.Float(0), mi.Float(0), free
    )
    event = first + 1  # where the stream of numbers is
    active = dr.full(mi.Bool, True, dr.width(o))  # lanes under way
    behind = mi.Bool(False)  # whether the facet has been met
    tail = SubpathTail.empty()  # the last vertices
    passes = mi.UInt32(0)  # volume vertices that may still be passed
    chain = ImageChain.closed()  # smooth mirrors behind the facet
    share = mi.Float(1.0)  # of light straight from the lamp, beside aimed subpaths
    followed = mi.UInt32(0)  # events that an aimed subpath would have taken
    while active:
        segment, begin = MetLamp.of(state, tail.p), mi.Point3f(state.o)
        state, v, arrived, escaped = trace_segment(scene, state, active)
        choose_glossy, choose_end, choose_lamp, _ = stream.event(event + events)
        if lamp is not None:
            passed = lamp.passed(segment, begin, state, v, arrived, escaped)
            passed &= active & behind
            # Aimed subpaths pass delta faces alone, and not none.
            straight = (end.total == 0.0) & (glossy.total == 0.0)
            if lamp.light.cast_in is not None:
                straight &= segment.d_vcm == 0.0
            followed += dr.select(behind, mi.UInt32(1), 0)
            straight &= followed < AIMED_EVENTS
            segment.beta *= dr.select(straight, share, 1.0)
            # Aimed subpaths end where they met the lamp.
            followed = dr.select(passed & straight, AIMED_EVENTS, followed)
            met = met.update(segment, dr.select(passed, 1.0, 0.0), choose_lamp)
        else:
            v.terminal = v.terminal | (v.diffuse & behind)
        # Up to the facet only one strategy exists: there are no sums to carry.
        v.d_vcm = dr.select(behind, v.d_vcm, 0.0)
        v.d_vc = dr.select(behind, v.d_vc, 0.0)
        # A mirror connection could have found the vertex before this one, whatever comes next.
        v.d_vcm = shared_d_vcm(mirror, v, tail, arrived, from_camera=True)
        # So could an image connection the one that follows the facet over smooth mirrors.
        if images is not None:
            following, imaged = images.arrive(chain, v, state, facet, ~v.delta)
            v.d_vcm = dr.select(arrived & (imaged > 0), dr.minimum(imaged, RATIO_MAX), v.d_vcm)
            chain = dr.select(arrived, following, chain)
        if passable:
            v.terminal = v.terminal & (passes == 0)
            passes = dr.select(arrived, passes_behind(v, passes), passes)
        absorbed = arrived & v.terminal
        # ------------------------------ Keep vertices -----------------------------
        # A volume behind the facet is left to light subpaths; one before it is what is seen.
        # Every end and every glossy vertex are kept with the same chance.
        is_end = arrived & dr.select(behind, v.diffuse, v.volume)
        if passable:
            is_end |= arrived & v.volume
        following = tail.then(v)
        # Mirror connections start from the facet alone.
        following.glossy_after_wide &= behind & (end.total == 0.0)
        tail = dr.select(arrived, following, tail)
        here = CellVertex(v, tail.previous, tail.glossy_after_wide, passes)
        end = end.update(here, dr.select(is_end, 1.0, 0.0), choose_end)
        is_facet = arrived & v.diffuse & ~behind
        facet = dr.select(is_facet, v, facet)
        is_glossy = arrived & behind & ~v.terminal & ~v.delta & ~is_end
        glossy = glossy.update(here, dr.select(is_glossy, 1.0, 0.0), choose_glossy)
        behind |= is_facet
        if passable:
            # A volume that is seen takes the place of the facet.
            behind |= is_end
            passes = dr.select(arrived & v.delta, VOLUME_PASSES, passes)
        # -------------------------- Scatter, or end the path ----------------------
        going = arrived & ~absorbed
        state, alive = sample_scattering(
            state, v, mi.TransportMode.Radiance, stream.event(event), going, guiding
        )
        if images is not None:
            refracted = dr.dot(v.n, state.d) * dr.dot(v.n, v.wi) < 0
            chain.open &= ~(arrived & refracted)
            started = ImageChain.closed()
            started.open, started.d_vcm = mi.Bool(True), mi.Float(state.d_vcm)
            chain = dr.select(is_facet, started, chain)
        if aimed is not None:
            own = aimed.share(facet, state.d, dr.rcp(state.d_vcm))
            share = dr.select(is_facet, own, share)
        active &= ~escaped & ~absorbed & (~arrived | alive) & (event < first + events)
        event += 1
    for kept in (glossy, end):
        kept.item.vertex.weight = kept.contribution_weight()
    met.item.weight = met.contribution_weight()
    return FacetSubpath(facet, glossy.item, end.item, met.item)


@dr.syntax
def radiance_per_node(
    scene: mi.Scene, light: DrawnVertices, lane: mi.UInt32, camera: FacetSubpath, stream: Stream,
    offset: mi.UInt32, guiding: GuidingDistribution, mirror: LowerFaceMirror | None,
    images: MirrorImages | None, lamp: Lamp | None, aimed: AimedSubpaths | None, lobed: bool,
) -> list[mi.Float]:  # fmt: skip
    """Return, per direction node, what the lamp and its light vertices of ``lane`` send.

    ``offset`` keeps the random numbers of several camera subpaths of one lane apart; ``lobed`` says
    that the skin has a lobe beside Lambert's.
    """
    # Light vertices that camera subpaths pass as they are guided.
    returning = guiding if lobed and lamp is not None else None
    last = mi.UInt32(light.paths)
    dr.make_opaque(last)
    sums = [dr.zeros(mi.Float, dr.width(lane)) for _ in light.weight]  # radiance per node
    path = dr.zeros(mi.UInt32, dr.width(lane))  # which light subpath
    while path < last:
        drawn = light.read(path, lane)
        number = (path + 1) * LIGHT_EVENTS - 1 - offset
        radiance = _connect(
            scene, drawn, camera, stream.event(number), drawn.contribution > 0, guiding, mirror,
            images, returning,
        )  # fmt: skip
        for j in range(len(sums)):
            weight = dr.gather(mi.Float, light.weight[j], light.index(path, lane))
            sums[j] += radiance * weight
        path += 1
    if lamp is not None:
        found = [lamp.met(camera.met)]
        # A bare coating sees the lamp, or one in the pad; otherwise only the pad's faces do.
        glossy, end = camera.glossy.vertex, camera.end.vertex
        last_vertices = [camera.facet, end] if lamp.bare else [glossy]
        if lamp.light.cast_in is not None and not lamp.bare:
            last_vertices = [camera.facet, end, glossy]
        for i in range(len(last_vertices)):
            numbers = stream.event((last + 1) * LIGHT_EVENTS - 1 - offset - i * JOINED_STRIDE)
            found.append(lamp.joined(scene, last_vertices[i], numbers, guiding))
        if aimed is not None:
            number = (last + 1) * LIGHT_EVENTS - 4 * JOINED_STRIDE + offset * 2 * AIMED_EVENTS
            found.append(aimed.light(scene, camera.facet, stream, number))
        for values in found:
            for j in range(len(sums)):
                sums[j] += values[j]
    return sums


@dr.syntax
def _connect(
    scene: mi.Scene, drawn: DrawnVertex, camera: FacetSubpath, numbers: Numbers, active: mi.Bool,
    guiding: GuidingDistribution, mirror: LowerFaceMirror | None, images: MirrorImages | None,
    returning: GuidingDistribution | None,
) -> mi.Float:  # fmt: skip
    """Return the light of the drawn vertex over all connections."""
    y, a = drawn.vertex, camera.facet
    other = dr.select(numbers[2] < 0.5, camera.end, camera.glossy)
    later, over_delta = y, y
    if isinstance(y, PassableVertex):
        over_delta = for_camera_passes(y, mi.UInt32(VOLUME_PASSES))
        later = for_camera_passes(y, other.passes)
        y = for_camera_passes(y, mi.UInt32(0))
    wide = active & has_wide_lobe(y)
    # ------------------------------ With the facet --------------------------------
    facet = KeptVertex(a, a.p, mi.Bool(False))
    further = mirror_ratio(mirror, drawn, facet, active)
    light = channel_mean(
        connect_vertices(scene, y, a, active, guiding, extra=further, returning=returning)
    )
    # ------------------------------ With what follows it --------------------------
    # These carry little light: each vertex tries one of them. No mirror connection starts there.
    unmirrored = KeptVertex(y, y.p, mi.Bool(False))
    further = mirror_ratio(mirror, unmirrored, other, active)
    light += 2.0 * channel_mean(
        connect_vertices(
            scene, later, other.vertex, active, guiding, extra=further, returning=returning
        )
    )
    # ------------------------------ Over mirrors ----------------------------------
    if images is not None:
        number = numbers[0] if mirror is None else numbers[3]
        light += channel_mean(
            images.connect(scene, over_delta, a, number, active, guiding, returning)
        )
    if mirror is not None:
        reflected = mirror_connection(
            scene, y, a, mirror.lobe(a.p, y.p), numbers[:2], wide, guiding=guiding,
            returning=returning,
        )  # fmt: skip
        light += channel_mean(reflected)
    return light
