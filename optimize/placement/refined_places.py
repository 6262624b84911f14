"""Places refined beyond the pitch of their rails: a pattern search on the preview.

Candidates are drawn anew around every place that a design lights, half a pitch away, then a quarter
and so on, until that is below what a hand keeps to; heights and tilts in the ranges in which rails
leave them free. Light is linear in lamps: a round's candidates are one table, on which places move
one or two at a time, the best first, as long as that helps (Hooke and Jeeves 1961). The preview
draws every round alike, so that its noise is common to all. Traced light then chooses among all
places, those that the preview ends at and those around them.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Mapping, Sequence
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
from render.scene.lamps import PlacedLamp
from render.scene.places import CandidateLamp, Room, image_of, misfits, rail_places

LEAST_GAIN = 1e-4
"""Of the objective, relative: what gains less is no move."""
MOST_MOVES = 2000
"""Of which the best is taken, in some seconds."""
AROUND = 0.5, 0.25
"""Parts of a pitch by which traced light may move a place further."""
Body = tuple[float, object]
"""Diameter and profile, by which parts on one place are told apart."""
Key = tuple[tuple[float, ...], Body | None, int]
"""Place and beam of a lamp, its body where lamps are parts, and how many are there after it."""


@dataclass(frozen=True, eq=False)
class RefinedPlaces:
    """Places near those of a design, and what the preview says of both.

    Arguments:
        scene: all places, those of the design, and those around them for traced light.
        design: the design on it, at its new places.
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
    *,
    traced: bool = False,
) -> RefinedPlaces | None:
    """Return better places near those that ``design`` lights; None where nothing is free or gains.

    Lamps of the ``scene`` itself, and parts on their places, stay where they are.

    Arguments:
        scene: the sensor.
        searched: its `searched_scene`.
        design: what was found on that.
        objective: what it was searched by.
        progress: told of every round.
        traced: traced light follows, and may move places further: it gets some around them, even
            where none gains on the preview.
    """
    lit = _lit(scene, searched, design)
    widest = max((one.widest for one in lit), default=0.0)
    if widest < 2.0:
        return None
    rounds = math.ceil(math.log2(widest))
    clock = Clock(rounds, progress)
    values: list[float] = []
    now = lit
    for number in range(rounds):
        table = _Round(scene, searched, design, objective, now, 0.5 ** (number + 1))
        values += table.climb()
        now = table.lit
        clock.tick()
    before, after = values[0], values[-1]
    gains = after > before + LEAST_GAIN * abs(before)
    if not gains and not traced:
        return None
    now = now if gains else lit
    moved = [
        float(np.linalg.norm(new.position - old.position))
        for one, was in zip(now, lit, strict=True)
        for new, old in zip(one.lamps, was.lamps, strict=True)
    ]
    new = [lamp for one in now for lamp in one.lamps]
    if traced:
        new += [lamp for one in now for part in AROUND for around in _around(scene, one, part)
                for lamp in around]  # fmt: skip
    every = {_place(one): one for one in (*candidates_of(scene), *new)}
    finer = _drawn(scene, searched, list(every.values()))
    return RefinedPlaces(
        finer,
        _moved_design(design, _numbers(searched), _numbers(finer), now),
        abs(before),
        abs(after),
        tuple(moved),
    )


def _drawn(
    scene: Scene, searched: Scene, places: Sequence[CandidateLamp], lamps: int | None = None
) -> Scene:
    """Return the searched scene with other places; as many lamps may be lit unless said."""
    assert searched.search is not None
    return searched_scene(
        scene,
        lamps=lamps or searched.search.lamps,
        parts=searched.search.parts or None,
        shots=searched.palette.shots if searched.palette.shots > 1 else None,
        candidates=places,
    )


def _place(lamp: PlacedLamp | CandidateLamp) -> tuple[float, ...]:
    """Return where a lamp is and shines, as a name of it."""
    beam = lamp.beam if isinstance(lamp, PlacedLamp) else lamp.direction
    return tuple(np.round([*lamp.position, *beam], 6).tolist())


def _numbers(scene: Scene) -> dict[Key, int]:
    """Return the number of each lamp by its place, and by its body where lamps are parts.

    Of lamps at one place, as dies of an LED are, the last counts as 0, the one before as 1.
    """
    parts = bool(scene.search and scene.search.parts)
    found: dict[Key, int] = {}
    later: Counter[tuple[object, ...]] = Counter()
    for number, lamp in reversed(list(enumerate(scene.placed_lamps()))):
        place, body = _place(lamp), _body(lamp) if parts else None
        found[place, body, later[place, body]] = number
        later[place, body] += 1
    return found


def _body(lamp: PlacedLamp) -> Body:
    return lamp.diameter, lamp.profile


@dataclass(frozen=True, eq=False)
class _Lit:
    """A place that is lit, with its image where it has one.

    Arguments:
        members: numbers of the lamps of the searched scene.
        bodies: theirs, where lamps are parts.
        lamps: where they are now.
        widest: see `RailPlaces.widest`; 0 where it stays.
    """

    members: tuple[int, ...]
    bodies: tuple[Body | None, ...]
    lamps: tuple[CandidateLamp, ...]
    widest: float

    def keys(self, lamps: Sequence[CandidateLamp]) -> list[Key]:
        """Return the names of its lamps at other places."""
        return [(_place(one), body, 0) for one, body in zip(lamps, self.bodies, strict=True)]


def _moved_design(
    design: Design, old: Mapping[Key, int], new: Mapping[Key, int], lit: Sequence[_Lit]
) -> Design:
    """Return a ``design`` of lamps with ``old`` numbers on ``new`` ones, ``lit`` ones moved."""
    moved = {lamp for one in lit for lamp in one.members}
    phi = np.full(len(new), math.pi / 2)
    drive = np.zeros((len(phi), design.drive.shape[1]))
    pairs = [(number, new[key]) for key, number in old.items()
             if key in new and number not in moved]  # fmt: skip
    for one in lit:
        pairs += zip(one.members, (new[key] for key in one.keys(one.lamps)), strict=True)
    for was, now in pairs:
        phi[now], drive[now] = design.phi[was], design.drive[was]
    return Design(phi, drive, design.palette)


def _lit(scene: Scene, searched: Scene, design: Design) -> list[_Lit]:
    """Return the places that a design lights; those whose image is a lamp of the scene stay."""
    mirror, own = scene.search.mirror if scene.search is not None else None, scene.lamp_count
    places, placed = candidates_of(scene), searched.placed_lamps()
    parts = bool(searched.search and searched.search.parts)
    there = {_place(one): number for number, one in enumerate(places)}
    # Lamps by the number of their place; those on places of the scene's own lamps stay.
    lamps = {
        there[_place(lamp)]: number
        for number, lamp in enumerate(placed)
        if number >= own and design.colors[number] != DARK and _place(lamp) in there
    }
    found: list[_Lit] = []
    taken: set[int] = set()
    for number in sorted(lamps):
        if number in taken:
            continue
        candidate = places[number]
        group, widest = [number], rail_places(scene, candidate.rail).widest
        if candidate.image:
            widest = 0.0
        elif mirror is not None and image_of(candidate, mirror) is not candidate:
            paired = number + 1 in lamps and places[number + 1].image
            group, widest = ([number, number + 1], widest) if paired else (group, 0.0)
        taken |= {*group}
        members = tuple(lamps[i] for i in group)
        bodies = tuple(_body(placed[i]) if parts else None for i in members)
        found.append(_Lit(members, bodies, tuple(places[i] for i in group), widest))
    return found


class _Round:
    """All places next to those that are lit now, on one table."""

    def __init__(
        self,
        scene: Scene,
        searched: Scene,
        design: Design,
        objective: ObjectiveName,
        lit: Sequence[_Lit],
        part: float,
    ) -> None:
        """Draw the preview of the lamps that are ``lit`` and of places a ``part`` away."""
        self.design, self.lit, self.old = design, list(lit), _numbers(searched)
        choices = [[one.lamps, *_around(scene, one, part)] for one in lit]
        # Two that are lit may have a place next to both.
        places = {_place(one): one for each in choices for pair in each for one in pair}
        lamps = list(places.values())
        drawn = _drawn(scene, searched, lamps, scene.lamp_count + len(lamps))
        self.new = _numbers(drawn)
        # A part may not fit on every place next to its own.
        self.choices = [
            [pair for pair in each if all(key in self.new for key in one.keys(pair))]
            for one, each in zip(lit, choices, strict=True)
        ]
        self.limits = limits_of(drawn)
        scorer = TableScorer(search_table(scene_model(drawn, coarse=True)), limits=self.limits)
        self.goal: Objective = NominalScore(scorer)
        if objective != "score":
            self.goal = ReaderObjective(scorer, drawn, objective, CameraModel.of(drawn))

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
                values = self.goal.values([design for _, design in moves])
                moved = len(values) > 0 and values.max() > best + LEAST_GAIN * abs(best)
                if moved:
                    (taken, _), best = moves[int(values.argmax())], float(values.max())
                    break
        self.lit = self._moved(taken)
        return first, best

    def _moves(self, taken: Sequence[int], at_once: int) -> list[tuple[list[int], Design]]:
        """Return choices in which so many places moved, and designs; none where too many."""
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
                keys = [key for one in self._moved(moved) for key in one.keys(one.lamps)]
                if len({*keys}) == len(keys):
                    found.append(moved)
        designs = [self._design(moved) for moved in found]
        fits = self.limits.fits(np.array([one.colors for one in designs])) if found else ()
        moves = zip(found, designs, fits, strict=True)
        return [(moved, design) for moved, design, keeps in moves if keeps]

    def _moved(self, taken: Sequence[int]) -> list[_Lit]:
        chosen = zip(self.lit, self.choices, taken, strict=True)
        return [replace(one, lamps=tuple(choices[number])) for one, choices, number in chosen]

    def _design(self, taken: Sequence[int]) -> Design:
        """Return the design that lights one choice of every place."""
        return _moved_design(self.design, self.old, self.new, self._moved(taken))


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
