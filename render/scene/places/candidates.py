"""Candidate lamps: the places of rails, with the body and the beam of a lamp of the scene.

A place that is nearer than `Search.apart` to a lamp or to an earlier place is left out, so that any
of them may be lit together. Where lamps are mirrored, a place comes with its image.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
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
from render.scene.lamps import EDGES, ListedLamp, PlacedLamp, placed_lamps
from render.scene.places.mirror import image_of, images
from render.scene.places.rail_places import CandidateLamp, half_edge, rail_places
from render.scene.places.search_section import Rail, Search

if TYPE_CHECKING:
    from render.scene.schema.scene import Scene

MOST_CANDIDATES = 256
"""More make tables that take minutes and gigabytes."""
MOST_LOOKED_AT = 20_000
"""Of a rail, also those where no lamp fits."""
SAME = 1e-3
"""mm: lamps that are nearer to each other are one."""


def candidates_on(scene: Scene, rails: Sequence[Rail] = ()) -> tuple[CandidateLamp, ...]:
    """Return the new places on ``rails``, in the order of the rails and along them.

    Keep-outs, the least distance and the mirror are those of the scene's ``search``. An image
    follows its place; what has none is left out.
    """
    found: list[CandidateLamp] = []
    room = Room(scene)
    for rail in rails:
        for candidate in rail_places(scene, rail).candidates():
            new = room.free_of((candidate,))
            if new is not None:
                room.take(new)
                found += new
    return tuple(found)


class Room:
    """What is taken on a scene: its lamps, keep-outs, and places that were given away."""

    def __init__(self, scene: Scene) -> None:
        """Take the places of the scene's lamps."""
        self.search = scene.search or Search.model_construct()
        self._lamps = scene.placed_lamps()
        self._taken = [(lamp.position, lamp.beam) for lamp in self._lamps]

    def take(self, candidates: Iterable[CandidateLamp]) -> None:
        """Give places away."""
        self._taken += [(one.position, one.direction) for one in candidates]

    def free_of(self, wanted: Sequence[CandidateLamp]) -> list[CandidateLamp] | None:
        """Return what is new of some places and their images; None where one cannot be had.

        What is there already, at the same place with the same direction, is not new.
        """
        whole = list(wanted)
        if self.search.mirror is not None:
            for candidate in wanted:
                image = image_of(candidate, self.search.mirror)
                if image is not candidate:
                    whole.append(image)
        new: list[CandidateLamp] = []
        for candidate in whole:
            diameter = self._lamps[candidate.like].diameter
            apart = (diameter if self.search.apart is None else self.search.apart) - 1e-6
            if any(
                part.holds(candidate.position, diameter / 2, candidate.edge)
                for part in self.search.keep_out
            ):
                return None
            if self._is_there(candidate):
                continue
            others = [place for place, _ in self._taken] + [one.position for one in new]
            if others and _nearest(others, candidate.position) < apart:
                return None
            new.append(candidate)
        return new or None

    def _is_there(self, candidate: CandidateLamp) -> bool:
        return self.search.mirror is not None and any(
            np.abs(place - candidate.position).max() < SAME
            and beam @ candidate.direction > 1 - SAME
            for place, beam in self._taken
        )


def usual_rails(scene: Scene) -> tuple[Rail, ...]:
    """Return a rail for every edge that holds lamps of the scene's kind.

    Those are the edges with a diffuser where there is one, and else all that are not painted;
    without those where such lamps do not fit.
    """
    rails = (Rail.model_construct(edge=edge) for edge in scene.diffuser_edges or EDGES)
    return tuple(
        rail for rail in rails if not any(misfits(scene, "", rail_places(scene, rail).candidates()))
    )


def candidate_problems(scene: Scene) -> Iterator[str]:
    """Yield what is wrong with the rails that a scene names, one sentence for each."""
    search = scene.search or Search.model_construct()
    half = {edge: half_edge(scene, edge) for edge in EDGES}
    total = 0
    for number, rail in enumerate(search.places):
        key = f"search.places.{number}"
        for name in ("between", "at"):
            reach = max(map(abs, getattr(rail, name) or (0.0,)))
            if rail.edge is not None and reach > half[rail.edge]:
                side = half[rail.edge]
                yield (
                    f"{key}.{name} = {reach:g} mm lies beside the edge, allowed: {-side:g} to "
                    f"{side:g} mm"
                )
        looked_at = rail_places(scene, rail).looked_at
        if looked_at > MOST_LOOKED_AT:
            yield (
                f"{key} looks at {looked_at:,} places, allowed: at most {MOST_LOOKED_AT:,}; take a "
                "larger pitch"
            )
            continue
        places = list(rail_places(scene, rail).candidates())
        if not places:
            yield f"{key}: no lamp fits on {rail.words}, allowed: room for at least a lamp"
        total += len(places)
        if len(places) <= MOST_CANDIDATES:
            yield from _range_problems(scene, rail, key)
            yield from misfits(scene, key, places)
            if search.mirror is not None:
                yield from _image_problems(scene, search, key, places)
    if total > MOST_CANDIDATES:
        yield (
            f"search.places have {total} places, allowed: at most {MOST_CANDIDATES}; take a larger "
            "pitch"
        )
    if search.mirror is not None and not search.places and not any(
        image is not None for image in images(scene.placed_lamps(), search.mirror)
    ):  # fmt: skip
        yield (
            f'search.mirror = "{search.mirror}", but no lamp has an image at {search.mirror} = 0, '
            "allowed: search.places, or lamps that are mirrored"
        )


def lamp_problems(scene: Scene, lamp: PlacedLamp) -> list[str]:
    """Return why a lamp cannot be where it is, as problems of ``lamps.0``."""
    placed = (lamp,)
    problems = [
        *placement_problems(placed, scene.box),
        *aim_problems(placed),
        *embedding_problems(placed, scene.box, refracts=scene.window_refracts),
        *painted_lamp_problems(placed, scene.finishes),
    ]
    if lamp.solid:
        problems += embedding_under_skin_problems(
            placed, scene.pad, scene.skin, scene.sites, scene.indenter
        )
    return problems


def _range_problems(scene: Scene, rail: Rail, key: str) -> Iterator[str]:
    """Yield which values lie outside of the range in which they are free, and ends that misfit."""
    places = rail_places(scene, rail)
    tilts = () if rail.tilt is None else (rail.tilt,)
    for name, said in (("heights", rail.heights or ()), ("tilt", tilts)):
        ends = places.spans.get(name.removesuffix("s"))
        if ends is None:
            continue
        unit, scale = ("mm", 1.0) if name == "heights" else ("deg", math.degrees(1.0))
        kept = f"{name.removesuffix('s')}_range"
        for value in said:
            if not ends[0] <= value <= ends[1]:
                yield (
                    f"{key}.{name} = {scale * value:g} {unit} lies outside of {kept}, allowed: "
                    f"{scale * ends[0]:g} to {scale * ends[1]:g} {unit}"
                )
        for end in ends:
            moved = (
                places.candidate(
                    replace(one.place, height=end)
                    if name == "heights"
                    else replace(one.place, tilt=end)
                )
                for one in places.candidates()
            )
            yield from misfits(scene, f"{key}.{kept}", moved)


def _image_problems(
    scene: Scene, search: Search, key: str, places: Sequence[CandidateLamp]
) -> Iterator[str]:
    """Yield that images cannot be, or that none of a rail keep apart from their places."""
    assert search.mirror is not None
    pairs = [(one, image_of(one, search.mirror)) for one in places]
    mirrored = [image for one, image in pairs if image is not one]
    yield from misfits(scene, key, mirrored)
    diameter = [scene.placed_lamps()[one.like].diameter for one in places]
    apart = [search.apart or size for size in diameter]
    if not any(
        image is one or np.linalg.norm(one.position - image.position) >= least - 1e-6
        for (one, image), least in zip(pairs, apart, strict=True)
    ):
        one, image = pairs[0]
        least = np.linalg.norm(one.position - image.position)
        yield (
            f"{key}: mirrored at {search.mirror} = 0 its places fall on each other, {least:.3g} mm "
            f"apart, allowed: at least {apart[0]:g} mm, or places on {search.mirror} = 0 that "
            "shine along it"
        )


def misfits(scene: Scene, key: str, candidates: Iterable[CandidateLamp]) -> Iterator[str]:
    """Yield why lamps cannot be where a rail has them: of the first that cannot."""
    lamps = scene.placed_lamps()
    for candidate in candidates:
        problems = lamp_problems(scene, as_placed(scene, candidate, lamps))
        if problems:
            image = f", image at {scene.search.mirror} = 0" if (
                candidate.image and scene.search is not None
            ) else ""  # fmt: skip
            where = f"{key}, {candidate.rail.words}{image}: a lamp"
            yield problems[0].replace("lamps.0", where, 1)
            return


def as_placed(scene: Scene, candidate: CandidateLamp, lamps: Sequence[PlacedLamp]) -> PlacedLamp:
    """Return a candidate as a lamp of the scene."""
    like = lamps[candidate.like]
    listed = ListedLamp.model_construct(
        position=tuple(candidate.position),
        direction=tuple(candidate.direction),
        diameter=like.diameter,
        profile=like.profile,
        turns=like.turns and not candidate.upright,
    )
    return placed_lamps(scene.box, (), (listed,), False)[0]


def _nearest(places: Sequence[Array], place: Array) -> float:
    return float(np.linalg.norm(np.array(places) - place, axis=1).min())
