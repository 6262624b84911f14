"""Candidate lamps: the places of rails, with the body and the beam of a lamp of the scene.

A place that is nearer than `Search.apart` to a lamp or to an earlier place is left out, so that any
of them may be lit together.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from render.arrays import Array
from render.scene.built_geometry import (
    aim_problems,
    embedding_problems,
    embedding_under_skin_problems,
    placement_problems,
)
from render.scene.faces import painted_lamp_problems
from render.scene.lamps import (
    EDGES,
    OUTWARD,
    Edge,
    ListedLamp,
    PlacedLamp,
    Row,
    placed_lamps,
)
from render.scene.places.search_section import Rail, Search

if TYPE_CHECKING:
    from render.scene.schema.scene import Scene

PITCH = 2.0
"""Diameters between neighbors of a rail that names no pitch."""
ROUNDED = 4
"""Digits of mm that a candidate's place has."""
MOST_CANDIDATES = 256
"""More make tables that take minutes and gigabytes."""


@dataclass(frozen=True, eq=False)
class CandidateLamp:
    """A lamp that may be placed.

    Arguments:
        edge, along: where it is, mm from the middle of the edge.
        like: number of the lamp whose body it has.
        position, direction: ``(3,)`` mm, and a unit vector.
    """

    edge: Edge
    along: float
    like: int
    position: Array
    direction: Array


def candidates_on(scene: Scene, rails: Sequence[Rail] = ()) -> tuple[CandidateLamp, ...]:
    """Return the new places on ``rails``, in the order of the edges and along them.

    Keep-outs and the least distance are those of the scene's ``search``.
    """
    search, lamps = scene.search or Search.model_construct(), scene.placed_lamps()
    taken = [lamp.position for lamp in lamps]
    found: list[CandidateLamp] = []
    for rail in rails:
        for candidate in _places(scene, rail, lamps):
            diameter = lamps[candidate.like].diameter
            apart = (diameter if search.apart is None else search.apart) - 1e-6
            kept_out = any(
                part.edge == rail.edge and part.holds(candidate.along, diameter / 2)
                for part in search.keep_out
            )
            if (
                kept_out
                or np.linalg.norm(np.array(taken) - candidate.position, axis=1).min() < apart
            ):
                continue
            taken.append(candidate.position)
            found.append(candidate)
    return tuple(found)


def usual_rails(scene: Scene) -> tuple[Rail, ...]:
    """Return a rail for every edge that holds lamps of the scene's kind.

    Those are the edges with a diffuser where there is one, and else all that are not painted;
    without those where such lamps do not fit.
    """
    lamps = scene.placed_lamps()
    rails = (Rail.model_construct(edge=edge) for edge in scene.diffuser_edges or EDGES)
    return tuple(
        rail for rail in rails if not any(_misfits(scene, rail, "", _places(scene, rail, lamps)))
    )


def candidate_problems(scene: Scene) -> Iterator[str]:
    """Yield what is wrong with the rails that a scene names, one sentence for each."""
    rails = scene.search.places if scene.search is not None else ()
    lamps, half = scene.placed_lamps(), {edge: _half_edge(scene, edge) for edge in EDGES}
    total = 0
    for number, rail in enumerate(rails):
        key = f"search.places.{number}"
        for name in ("between", "at"):
            reach = max(map(abs, getattr(rail, name) or (0.0,)))
            if reach > half[rail.edge]:
                side = half[rail.edge]
                yield (
                    f"{key}.{name} = {reach:g} mm lies beside the edge, allowed: {-side:g} to "
                    f"{side:g} mm"
                )
        places = list(_places(scene, rail, lamps))
        if not places:
            yield f"{key}: no lamp fits along it, allowed: at least a lamp's diameter of an edge"
        total += len(places)
        if len(places) <= MOST_CANDIDATES:
            yield from _misfits(scene, rail, key, places)
    if total > MOST_CANDIDATES:
        yield (
            f"search.places have {total} places, allowed: at most {MOST_CANDIDATES}; take a larger "
            "pitch"
        )


def lamp_problems(scene: Scene, lamp: ListedLamp) -> list[str]:
    """Return why a lamp cannot be where it is, as problems of ``lamps.0``."""
    placed = placed_lamps(scene.box, (), (lamp,), False)
    problems = [
        *placement_problems(placed, scene.box),
        *aim_problems(placed),
        *embedding_problems(placed, scene.box, refracts=scene.window_refracts),
        *painted_lamp_problems(placed, scene.finishes),
    ]
    if placed[0].solid:
        problems += embedding_under_skin_problems(
            placed, scene.pad, scene.skin, scene.sites, scene.indenter
        )
    return problems


def _misfits(
    scene: Scene,
    rail: Rail,
    key: str,
    candidates: Sequence[CandidateLamp] | Iterator[CandidateLamp],
) -> Iterator[str]:
    """Yield why lamps cannot be where a rail has them: of the first that cannot."""
    lamps = scene.placed_lamps()
    for candidate in candidates:
        like = lamps[candidate.like]
        listed = ListedLamp.model_construct(
            position=tuple(candidate.position),
            direction=tuple(candidate.direction),
            diameter=like.diameter,
            profile=like.profile,
            turns=like.turns,
        )
        problems = lamp_problems(scene, listed)
        if problems:
            yield problems[0].replace("lamps.0", f"{key}, the {rail.edge} edge: a lamp", 1)
            return


def _places(scene: Scene, rail: Rail, lamps: Sequence[PlacedLamp]) -> Iterator[CandidateLamp]:
    """Yield the places of a rail, whatever lies there already."""
    number, half = EDGES.index(rail.edge), _half_edge(scene, rail.edge)
    outward = OUTWARD[number]
    face = outward * np.abs([*scene.box.low[:2], 0.0] if outward.sum() < 0 else scene.box.high)
    like = _nearest(lamps, face * [1.0, 1.0, 0.0]) if rail.like is None else rail.like
    body, own = lamps[like], _edge_of(lamps[like])
    radius = body.diameter / 2
    heights = rail.heights
    if heights is None:
        heights = tuple(sorted({round(float(lamp.position[2]), ROUNDED) for lamp in lamps
                                if _edge_of(lamp) == own}))  # fmt: skip
    tilt = body.tilt if rail.tilt is None else rail.tilt
    gap = float(scene.box.distance(body.position)[own]) if rail.gap is None else rail.gap
    if rail.at is not None:
        along = sorted(rail.at)
    else:
        low, high = rail.between or (radius - half, half - radius)
        pitch = PITCH * body.diameter if rail.pitch is None else rail.pitch
        steps = math.floor((high - low) / pitch + 1e-9)
        along = [(low + high + (2 * step - steps) * pitch) / 2 for step in range(steps + 1)]
    axis = int(np.abs(outward[:2]).argmin())
    for height in heights:
        row = Row.model_construct(
            edge=rail.edge,
            at=tuple(along),
            diameter=body.diameter,
            gap=gap,
            height=height,
            tilt=tilt,
            profile=body.profile,
            turns=body.turns,
        )
        placed = placed_lamps(scene.box, (row,), (), False)
        for lamp in sorted(placed, key=lambda lamp: float(lamp.position[axis])):
            yield CandidateLamp(
                rail.edge,
                float(lamp.position[axis]),
                like,
                np.round(lamp.position, ROUNDED) + 0.0,
                lamp.beam + 0.0,
            )


def _half_edge(scene: Scene, edge: Edge) -> float:
    return (scene.pad.width if edge in ("tip", "base") else scene.pad.length) / 2


def _edge_of(lamp: PlacedLamp) -> int:
    """Return the number of the edge that a lamp belongs to: that of its row, or behind it."""
    if lamp.edge is not None:
        return EDGES.index(lamp.edge)
    if lamp.face < len(EDGES):
        return lamp.face
    return int((-OUTWARD[: len(EDGES)] @ lamp.inward).argmax())


def _nearest(lamps: Sequence[PlacedLamp], place: Array) -> int:
    """Return the number of the lamp nearest to a ``place``, seen along z."""
    return int(np.argmin([np.hypot(*(lamp.position - place)[:2]) for lamp in lamps]))
