"""Places refined beyond the pitch of their rails: a pattern search on the preview.

Candidates are drawn anew around every place that a design lights, half a pitch away, then a quarter
and so on, until that is below what a hand keeps to; heights and tilts in the ranges in which rails
leave them free. Light is linear in lamps: a round's candidates are one table, on which places move
one or two at a time, the best first, as long as that helps (Hooke and Jeeves 1961). The preview
draws every round alike, so that its noise is common to all.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from optimize.design import DARK, Design, limits_of
from optimize.objectives import ObjectiveName
from optimize.placement.searched_scene import candidates_of, searched_scene
from optimize.readers import CameraModel
from optimize.scoring import TableScorer, scene_model, search_table
from optimize.search import NominalScore, Objective, ReaderObjective
from render.progress import Clock, OnProgress
from render.scene import Scene
from render.scene.places import CandidateLamp, Room, image_of, misfits, rail_places

LEAST_GAIN = 1e-4
"""Of the objective, relative: what gains less is no move."""
MOST_MOVES = 2000
"""Of which the best is taken, in some seconds."""


@dataclass(frozen=True, eq=False)
class RefinedPlaces:
    """Places near those of a design, and what the preview says of both.

    Arguments:
        scene: all places, those of the design moved.
        design: the design on it.
        before, after: the objective on the preview, degrees or counts.
        moved: how far (mm) each lamp that was free was moved.
    """

    scene: Scene
    design: Design
    before: float
    after: float
    moved: tuple[float, ...]


def refined_places(
    scene: Scene,
    searched: Scene,
    design: Design,
    objective: ObjectiveName,
    progress: OnProgress | None = None,
) -> RefinedPlaces | None:
    """Return better places near those that ``design`` lights; None where nothing is free or gains.

    Lamps of the ``scene`` itself stay where they are.

    Arguments:
        scene: the sensor.
        searched: its `searched_scene`.
        design: what was found on that.
        objective: what it was searched by.
        progress: told of every round.
    """
    places, own = candidates_of(scene), scene.lamp_count
    lit = _lit(scene, places, design)
    widest = max((one.widest for one in lit), default=0.0)
    if widest < 2.0:
        return None
    rounds = math.ceil(math.log2(widest))
    clock = Clock(rounds, progress)
    values: list[float] = []
    now = lit
    for number in range(rounds):
        table = _Round(scene, design, objective, now, 0.5 ** (number + 1))
        values += table.climb()
        now = table.lit
        clock.tick()
    before, after = values[0], values[-1]
    placed = {i: lamp for one in now for i, lamp in zip(one.members, one.lamps, strict=True)}
    moved = [
        float(np.linalg.norm(lamp.position - places[i].position)) for i, lamp in placed.items()
    ]
    if after <= before + LEAST_GAIN * abs(before):
        return None
    kept = {
        number: placed.get(number, candidate)
        for number, candidate in enumerate(places)
        if number in placed or not _too_near(scene, candidate, list(placed.values()))
    }
    rows = [*range(own), *(own + number for number in kept)]
    most = searched.search.lamps if searched.search is not None else None
    return RefinedPlaces(
        searched_scene(scene, lamps=most, candidates=list(kept.values())),
        replace(design, phi=design.phi[rows], drive=design.drive[rows]),
        abs(before),
        abs(after),
        tuple(moved),
    )


@dataclass(frozen=True, eq=False)
class _Lit:
    """A place that is lit, with its image where it has one.

    Arguments:
        members: numbers of the candidates.
        lamps: where they are now.
        widest: see `RailPlaces.widest`; 0 where it stays.
    """

    members: tuple[int, ...]
    lamps: tuple[CandidateLamp, ...]
    widest: float


def _lit(scene: Scene, places: Sequence[CandidateLamp], design: Design) -> list[_Lit]:
    """Return the places that a design lights; those whose image is a lamp of the scene stay."""
    mirror, own = scene.search.mirror if scene.search is not None else None, scene.lamp_count
    found: list[_Lit] = []
    for number, candidate in enumerate(places):
        taken = any(number in one.members for one in found)
        if taken or design.colors[own + number] == DARK:
            continue
        members: tuple[int, ...] = (number,)
        widest = rail_places(scene, candidate.rail).widest
        if candidate.image:
            widest = 0.0
        elif mirror is not None and image_of(candidate, mirror) is not candidate:
            paired = number + 1 < len(places) and places[number + 1].image
            members, widest = ((number, number + 1), widest) if paired else (members, 0.0)
        found.append(_Lit(members, tuple(places[i] for i in members), widest))
    return found


class _Round:
    """All places next to those that are lit now, on one table."""

    def __init__(
        self,
        scene: Scene,
        design: Design,
        objective: ObjectiveName,
        lit: Sequence[_Lit],
        part: float,
    ) -> None:
        """Draw the preview of the lamps that are ``lit`` and of places a ``part`` away."""
        self.own, self.design, self.lit = scene.lamp_count, design, list(lit)
        self.choices = [[one.lamps, *_around(scene, one, part)] for one in lit]
        lamps = [lamp for choices in self.choices for pair in choices for lamp in pair]
        drawn = searched_scene(scene, lamps=self.own + len(lamps), candidates=lamps)
        table = search_table(scene_model(drawn, coarse=True))
        scorer = TableScorer(table, limits=limits_of(drawn))
        self.goal: Objective = NominalScore(scorer)
        if objective != "score":
            self.goal = ReaderObjective(scorer, drawn, objective, CameraModel.of(drawn))
        self.count = self.own + len(lamps)
        body, apart = scene.placed_lamps(), scene.search.apart if scene.search else None
        self.apart = [apart or body[one.lamps[0].like].diameter for one in lit]

    def climb(self) -> tuple[float, float]:
        """Move one place at a time, the best first; return the objective before and after.

        Where none helps, two move together: what one gives up the other may need.
        """
        taken = [0] * len(self.lit)
        first = best = self.goal.value(self._design(taken))
        moved = True
        while moved:
            for at_once in (1, 2):
                moves = self._moves(taken, at_once)
                values = self.goal.values([self._design(move) for move in moves])
                moved = len(values) > 0 and values.max() > best + LEAST_GAIN * abs(best)
                if moved:
                    taken, best = moves[int(values.argmax())], float(values.max())
                    break
        chosen = zip(self.lit, self.choices, taken, strict=True)
        self.lit = [replace(one, lamps=tuple(choices[i])) for one, choices, i in chosen]
        return first, best

    def _moves(self, taken: Sequence[int], at_once: int) -> list[list[int]]:
        """Return the choices in which so many places moved; none where those are too many."""
        others = [[i for i in range(len(choices)) if i != now]
                  for choices, now in zip(self.choices, taken, strict=True)]  # fmt: skip
        sets = list(itertools.combinations(range(len(taken)), at_once))
        if sum(math.prod(len(others[i]) for i in movers) for movers in sets) > MOST_MOVES:
            return []
        found = []
        for movers in sets:
            for choice in itertools.product(*(others[i] for i in movers)):
                moved = list(taken)
                for mover, now in zip(movers, choice, strict=True):
                    moved[mover] = now
                found.append(moved)
        return [moved for moved in found if self._fits(moved)]

    def _design(self, taken: Sequence[int]) -> Design:
        """Return the design that lights one choice of every place."""
        phi = np.full(self.count, math.pi / 2)
        drive = np.zeros((self.count, self.design.drive.shape[1]))
        phi[: self.own], drive[: self.own] = (
            self.design.phi[: self.own],
            self.design.drive[: self.own],
        )
        row = self.own
        for one, choices, choice in zip(self.lit, self.choices, taken, strict=True):
            for number, pair in enumerate(choices):
                for member in one.members if number == choice else ():
                    at = row + one.members.index(member)
                    phi[at] = self.design.phi[self.own + member]
                    drive[at] = self.design.drive[self.own + member]
                row += len(pair)
        return Design(phi, drive, self.design.palette)

    def _fits(self, taken: Sequence[int]) -> bool:
        """Return whether bodies keep apart."""
        places = [
            (lamp.position, apart)
            for choices, choice, apart in zip(self.choices, taken, self.apart, strict=True)
            for lamp in choices[choice]
        ]
        return all(
            np.linalg.norm(place - other) >= max(apart, least) - 1e-6
            for number, (place, apart) in enumerate(places)
            for other, least in places[:number]
        )


def _around(scene: Scene, lit: _Lit, part: float) -> list[tuple[CandidateLamp, ...]]:
    """Return the places next to a lit one that its lamp, and the image, may have."""
    if lit.widest * part < 0.5:  # finer than it is to be known
        return []
    places, room = rail_places(scene, lit.lamps[0].rail), Room(scene)
    found = []
    for place in places.around(lit.lamps[0].place, part):
        new = room.free_of((places.candidate(place),))
        fits = new is not None and len(new) == len(lit.lamps)
        if new is not None and fits and not any(misfits(scene, "", new)):
            found.append(tuple(new))
    return found


def _too_near(scene: Scene, candidate: CandidateLamp, lit: Sequence[CandidateLamp]) -> bool:
    apart = scene.search.apart if scene.search is not None else None
    least = (apart or scene.placed_lamps()[candidate.like].diameter) - 1e-6
    return any(np.linalg.norm(candidate.position - one.position) < least for one in lit)
