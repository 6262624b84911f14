"""Local refinement: from good designs to the nearest optima, by exact derivatives.

L-BFGS-B (Byrd et al. 1995) over the directions and, where the builder allows it, over the power of
every LED that is on. S has kinks where facets clip; the best design met on the way is kept.

Behind a diffuser the directions of one coloring have a single optimum (measured: nine starts of
finger20 agree to 1e-6), so exact derivatives find it in some ten steps. That makes it affordable
to start from every promising coloring, also where something else than S on the table is maximized:
S with tolerances, or with shadows.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from optimize.design import DARK, Array, Design, ScoredDesign, SearchLimits
from optimize.scoring import ScoreMerit, TableScorer
from render.progress import Clock, OnProgress

MAX_ITERATIONS, EXACT = 200, 2.2e-9
"""Of L-BFGS-B, where the objective is S on the table; the tolerance is the library's own."""
DEAR_OPTIONS = {"maxiter": 60, "ftol": 1e-4}
"""Of L-BFGS-B, where the objective is dear; more starts bring more than more exact ends."""
CLIMBS = 4
"""Refined starts from which colors are climbed."""
TRIED_AT_ONCE = 12
"""Moves of colors of which the best is taken."""
LEAST_GAIN = 1e-4
"""Relative gain below which a move of colors is not worth the next refinement."""


class Objective(Protocol):
    """What is maximized, in counts, or minus degrees."""

    def values(self, designs: Sequence[Design]) -> Array:
        """Return the objective of every design, ``(N,)``."""

    def value(self, design: Design) -> float:
        """Return the objective of one design."""
        return float(self.values([design])[0])

    def gradient(self, design: Design) -> tuple[float, Array, Array]:
        """Return the objective and its derivatives.

        By the directions, ``(F,)`` per rad, and by power in the channels, ``(F, C)``.
        """


class NominalScore(Objective):
    """S on the table, the sensor as drawn, as an objective."""

    def __init__(self, scorer: TableScorer) -> None:
        self._scorer, self._exact = scorer, ScoreMerit(scorer)

    def values(self, designs: Sequence[Design]) -> Array:
        """Return S of every design."""
        return np.array([self._scorer.score(design.phi, design.power) for design in designs])

    def gradient(self, design: Design) -> tuple[float, Array, Array]:
        """Return S and its derivatives."""
        at = self._exact.gradient(design.phi, design.power)
        return at.value, at.phi, at.power


class WeightedSum(Objective):
    """The sum of objectives, each with a weight."""

    def __init__(self, *parts: tuple[float, Objective]) -> None:
        self.parts = parts

    def values(self, designs: Sequence[Design]) -> Array:
        """Return the weighted sum for every design."""
        return np.asarray(sum(weight * part.values(designs) for weight, part in self.parts))

    def gradient(self, design: Design) -> tuple[float, Array, Array]:
        """Return the weighted sum and its derivatives."""
        terms = [(weight, part.gradient(design)) for weight, part in self.parts]
        value = sum(weight * term[0] for weight, term in terms)
        by_phi, by_power = (
            np.asarray(sum(weight * term[part] for weight, term in terms)) for part in (1, 2)
        )
        return value, by_phi, by_power


@dataclass(frozen=True, eq=False)
class LocalOptimum(ScoredDesign):
    """A refined design, and how many designs were scored in which time."""

    evaluated: int
    seconds: float


def refine_locally(scorer: TableScorer, start: Design) -> LocalOptimum:
    """Return the local optimum of S near ``start``, within the limits of ``scorer``.

    Directions move inside the allowed interval that they start in; where directions have steps
    they stay as they are. Powers move only if the limits say that they are continuous, and only
    those of LEDs that are on.
    """
    began = time.perf_counter()
    goal = NominalScore(scorer)
    best, evaluated = _ascend(
        scorer, goal, start, scorer.limits, {"maxiter": MAX_ITERATIONS, "ftol": EXACT}
    )
    score = scorer.score(best.design.phi, best.design.power)
    return LocalOptimum(best.design, score, evaluated, time.perf_counter() - began)


def refine_by(scorer: TableScorer, objective: Objective, start: Design) -> ScoredDesign:
    """Return the local optimum of ``objective`` near ``start``, with the objective there.

    What moves is what `refine_locally` moves. Where directions have steps, those nearest to the
    optimum without steps are tried.
    """
    limits = scorer.limits
    best = _ascend(scorer, objective, start, limits, DEAR_OPTIONS)[0]
    if limits.step > 0.0:
        free = replace(limits, step=0.0)
        loose = _ascend(scorer, objective, start, free, DEAR_OPTIONS)[0].design
        near = replace(loose, phi=limits.nearest_directions(loose.phi))
        value = float(objective.values([near])[0])
        if value > best.score:
            best = ScoredDesign(near, value)
    return best


def multi_start(
    scorer: TableScorer,
    objective: Objective,
    starts: Sequence[Design],
    progress: OnProgress | None = None,
    climbs: int = CLIMBS,
) -> ScoredDesign:
    """Return the best design by ``objective`` within the limits of ``scorer``.

    Every one of ``starts`` is refined; from the best ``climbs`` of them on, one fiber takes another
    color or two exchange theirs, as long as that helps, and what that reaches is refined anew.
    """
    clock = Clock(len(starts) + climbs, progress)
    optima = []
    for start in starts:
        optima.append(refine_by(scorer, objective, start))
        clock.tick()
    optima.sort(key=lambda optimum: -optimum.score)
    climbed = []
    for optimum in optima[:climbs]:
        climbed.append(_climb(scorer, objective, optimum))
        clock.tick()
    return max(climbed, key=lambda optimum: optimum.score)


def _climb(scorer: TableScorer, objective: Objective, best: ScoredDesign) -> ScoredDesign:
    """Return what moves of colors, refined whenever none is left, reach from ``best``."""
    while True:
        refined = refine_by(scorer, objective, _recolored(scorer, objective, best).design)
        if refined.score <= best.score + LEAST_GAIN * abs(best.score):
            return best
        best = refined


def _recolored(scorer: TableScorer, objective: Objective, best: ScoredDesign) -> ScoredDesign:
    """Return what moves of single colors and of pairs reach from ``best`` at its directions.

    Moves are tried in the order that the objective's slopes foresee, until one helps or none is
    left.
    """
    while True:
        moved = _moves(scorer, best.design)
        _, _, by_power = objective.gradient(best.design)
        foreseen = [float((by_power * (move.power - best.design.power)).sum()) for move in moved]
        moved = [moved[place] for place in np.argsort(foreseen, kind="stable")[::-1]]
        for first in range(0, len(moved), TRIED_AT_ONCE):
            tried = moved[first : first + TRIED_AT_ONCE]
            values = objective.values(tried)
            leader = int(np.argmax(values))
            if values[leader] > best.score + LEAST_GAIN * abs(best.score):
                best = ScoredDesign(tried[leader], float(values[leader]))
                break
        else:
            return best


def _moves(scorer: TableScorer, design: Design) -> list[Design]:
    """Return the allowed designs that another color of one fiber makes, or a swap of two.

    Where a lit fiber goes off for a dark one, that one may have any color. Fibers that are tied
    move together.
    """
    limits, groups = scorer.limits, scorer.limits.groups
    old = design.colors[np.unique(groups, return_index=True)[1]]
    free = [limits.colors_of(np.flatnonzero(row)).tolist() for row in limits.of_groups[0]]
    changes: set[tuple[tuple[int, int], ...]] = set()  # by group
    for group, colors in enumerate(free):
        changes |= {((group, color),) for color in colors if color != old[group]}
    for first, second in itertools.combinations(range(len(old)), 2):
        if old[first] != old[second]:
            changes.add(((first, int(old[second])), (second, int(old[first]))))
        if (old[first] == DARK) != (old[second] == DARK):
            dark, lit = (first, second) if old[first] == DARK else (second, first)
            changes |= {
                tuple(sorted([(lit, DARK), (dark, color)])) for color in free[dark] if color != DARK
            }
    colorings = []
    for change in sorted(changes):
        recolored = old.copy()
        for group, color in change:
            recolored[group] = color
        colorings.append(recolored[groups])
    if not colorings:
        return []
    allowed = np.array(colorings)[limits.fits(np.array(colorings))]
    made = []
    for colors in allowed:
        moved = scorer.design(design.phi, colors)
        same = (colors == design.colors)[:, None]
        made.append(replace(moved, drive=np.where(same, design.drive, moved.drive)))
    return made


def _ascend(
    scorer: TableScorer,
    objective: Objective,
    start: Design,
    limits: SearchLimits,
    options: dict[str, float],
) -> tuple[ScoredDesign, int]:
    """Return the best design that L-BFGS-B meets from ``start``, and how many it tries.

    Where it ends on fibers that would meet in their holder, SLSQP (Kraft 1988) climbs from the
    best design so far, with the distances of neighbors as constraints.
    """
    from scipy.optimize import minimize

    on = np.zeros(start.drive.shape, dtype=bool)
    if limits.continuous_power:
        on = start.drive > 0.0
    low, high = _direction_bounds(scorer, limits, start.phi)
    full = np.broadcast_to(scorer.led_power, on.shape)[on]
    best = ScoredDesign(start, float(objective.values([start])[0]))
    fibers, evaluated, mirrored = len(low), 1, limits.directions.mirrored
    if not on.any() and (low == high).all():
        return best, evaluated

    def loss(x: Array) -> tuple[float, Array]:
        nonlocal best, evaluated
        drive = start.drive.copy()
        drive[on] = np.clip(x[fibers:], 0.0, full)
        design = replace(start, phi=mirrored(np.clip(x[:fibers], low, high)), drive=drive)
        score, by_phi, by_power = objective.gradient(design)
        by_lead = limits.directions.unmirrored(by_phi)
        slopes = np.concatenate([by_lead, (by_power @ design.palette.matrix.T)[on]])
        evaluated += 1
        if score > best.score and limits.fits_holder(design.phi):
            best = ScoredDesign(design, score)
        return -score, -slopes

    bounds = [*zip(low, high, strict=True), *((0.0, limit) for limit in full)]
    begin = np.concatenate([start.phi, start.drive[on]])
    end = minimize(loss, begin, jac=True, method="L-BFGS-B", bounds=bounds, options=options).x
    if (holder := limits.holder) and not limits.fits_holder(mirrored(end[:fibers])):
        minimize(
            loss,
            np.concatenate([best.design.phi, best.design.drive[on]]),
            jac=True,
            method="SLSQP",
            bounds=bounds,
            constraints={"type": "ineq", "fun": lambda x: holder.slack(mirrored(x[:fibers]))},
            options={
                "maxiter": options["maxiter"],
                "ftol": options["ftol"] * max(abs(best.score), 1e-12),
            },
        )
    return best, evaluated


def _direction_bounds(scorer: TableScorer, limits: SearchLimits, phi: Array) -> tuple[Array, Array]:
    """Return the ends of the allowed interval around every direction, ``(F,)`` rad each."""
    if limits.step > 0.0:
        return phi, phi
    first, last = scorer.phi_bounds
    inside = (limits.low <= phi[:, None]) & (phi[:, None] <= limits.high)
    interval = inside.argmax(axis=1)[:, None]
    low = np.take_along_axis(limits.low, interval, axis=1)[:, 0]
    high = np.take_along_axis(limits.high, interval, axis=1)[:, 0]
    return np.maximum(low, first), np.minimum(high, last)
