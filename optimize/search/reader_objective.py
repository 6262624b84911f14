"""Degrees of a reader as an objective: on a transport table, at each design's own exposure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from optimize.design import Array, Design, ScoredDesign
from optimize.objectives import ReaderName
from optimize.readers import CameraModel, ReaderMerit
from optimize.scoring import TableScorer
from optimize.search.colors.all_colorings import all_colorings
from optimize.search.colors.colorings import names_like
from optimize.search.local_refinement import Objective, multi_start
from render.progress import Clock, OnProgress
from render.scene import Scene

RANDOM, KEPT = 96, 3
"""Random colorings that are read, and the best of them, from which a search starts."""
MOST_PROVEN = 30_000
"""Designs of a class that is read as a whole, in some 15 s; of larger ones the best is searched.

Of a camera of three channels: a reader of twice as many takes some twenty times as long, so that
fewer are, with the cube of the channels. None can be left unread: a lamp that is added may raise or
lower an error (its light, its noise, the exposure, mistaken normals), so that a part of a design
bounds nothing.
"""
BLOCK = 256
"""Designs of such a class that are read between two looks at the clock."""
CELLS_AT_ONCE, MOST_AT_ONCE = 96, 8
"""States times sites, and designs, per call: their readers' matrices then stay in the cache."""


class ReaderObjective(Objective):
    """Minus the expected error of a reader in degrees: what a search maximizes."""

    def __init__(
        self, scorer: TableScorer, scene: Scene, reader: ReaderName, camera: CameraModel
    ) -> None:
        """Take the table of ``scorer``, which knows the untouched pad, and a ``reader`` of it.

        Raises:
            TableError: the table has no background.
        """
        self.camera, self._merit = camera, ReaderMerit(scorer, scene, reader, camera)
        states, sites = self._merit.cells[:2]
        self._at_once = min(max(CELLS_AT_ONCE // (states * sites), 1), MOST_AT_ONCE)

    def values(self, designs: Sequence[Design]) -> Array:
        """Return minus the expected errors ``(N,)`` in degrees."""
        found, known, light = np.empty(len(designs)), None, np.empty(0)
        for start in range(0, len(designs), self._at_once):
            counts = []
            for design in designs[start : start + self._at_once]:
                if known is None or not np.array_equal(design.phi, known):
                    known, light = design.phi, self._merit.light(design.phi)
                counts.append(self._merit.superposed(light, design.power))
            found[start : start + len(counts)] = self._merit.values(np.stack(counts))
        return found

    def gradient(self, design: Design) -> tuple[float, Array, Array]:
        """Return the value and its derivatives by directions ``(F,)`` and power ``(F, C)``."""
        at = self._merit.gradient(design.phi, design.power)
        return at.value, at.phi, at.power


@dataclass(frozen=True, eq=False)
class ReaderOptimum(ScoredDesign):
    """The design of least expected error; ``proven`` where all ``allowed`` ones were compared."""

    allowed: int | None = None

    @property
    def proven(self) -> bool:
        """Whether no allowed design has less on the table."""
        return self.allowed is not None


def search_by_reader(
    scorer: TableScorer,
    objective: Objective,
    starts: Sequence[Design],
    *,
    seed: int = 0,
    progress: OnProgress | None = None,
) -> ReaderOptimum:
    """Return the design that ``objective`` reads best, within the limits of ``scorer``.

    Where colors alone are chosen, and no more than `MOST_PROVEN` designs differ, all are read.
    Else searches begin at ``starts``, all allowed, and at the best of some random colorings of
    ``seed`` with the directions of the first.
    """
    found = _best_of_all(scorer, objective, starts[0], progress)
    if found is None:
        found = _best_of_searches(scorer, objective, starts, seed, progress)
    if not scorer.colors_alike:
        return found
    # Named so that most lamps keep their color: nobody rewires a sensor for other names.
    design = found.design
    names = names_like(design.colors, starts[0].colors, design.drive.shape[1])
    return replace(found, design=replace(design, drive=design.drive[:, np.argsort(names)]))


def _best_of_all(
    scorer: TableScorer, objective: Objective, start: Design, progress: OnProgress | None
) -> ReaderOptimum | None:
    """Return the best of all allowed designs, with the directions of ``start``; None: too many."""
    limits = scorer.limits
    if not limits.fixed_directions.all() or limits.continuous_power:
        return None
    most = int(MOST_PROVEN * min(1.0, (3 / scorer.channels) ** 3))
    every = all_colorings(limits, most, alike=scorer.colors_alike)
    if every is None or not len(every):
        return None
    clock, best = Clock(len(every), progress), ScoredDesign(start, -np.inf)
    for first in range(0, len(every), BLOCK):
        drawn = [scorer.design(start.phi, colors) for colors in every[first : first + BLOCK]]
        values = objective.values(drawn)
        leader = int(values.argmax())
        if values[leader] > best.score:
            best = ScoredDesign(drawn[leader], float(values[leader]))
        clock.tick(len(drawn))
    return ReaderOptimum(best.design, best.score, len(every))


def _best_of_searches(
    scorer: TableScorer,
    objective: Objective,
    starts: Sequence[Design],
    seed: int,
    progress: OnProgress | None,
) -> ReaderOptimum:
    """Return the best design that searches reach from ``starts`` and from random colorings."""
    rng, limits = np.random.default_rng(seed), scorer.limits
    preferences = rng.uniform(size=(RANDOM, *limits.allowed.shape))
    colorings = np.unique([limits.nearest_colors(row) for row in preferences], axis=0)
    drawn = [scorer.design(starts[0].phi, colors) for colors in colorings]
    order = np.argsort(-objective.values(drawn), kind="stable")
    best = [drawn[place] for place in order[:KEPT]]
    found = multi_start(scorer, objective, [*starts, *best], progress)
    return ReaderOptimum(found.design, found.score)
