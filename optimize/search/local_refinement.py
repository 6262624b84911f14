"""Local refinement: from good designs to the nearest optima, by exact derivatives.

L-BFGS-B (Byrd et al. 1995) over the directions and, where the builder allows it, over the power of
every LED that is on. S has kinks where facets clip; the best design met on the way is kept.

Behind a diffuser the directions of one coloring have a single optimum (measured: nine starts of
finger20 agree to 1e-6), so exact derivatives find it in some ten steps. That makes it affordable
to start from every promising coloring, also where something else than S on the table is maximized:
S with tolerances, or with shadows.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from optimize.design import Array, Design, ScoredDesign
from optimize.scoring import Differentiator, TableScorer
from render.progress import Clock, OnProgress

MAX_ITERATIONS = 200
DIRECTIONS_OPTIONS = {"maxiter": 60, "ftol": 1e-7}
"""Of L-BFGS-B, where directions alone move and the objective is dear."""


class Objective(Protocol):
    """What is maximized, in counts."""

    def value(self, design: Design) -> float:
        """Return the objective."""

    def gradient(self, design: Design) -> tuple[float, Array]:
        """Return the objective and its derivatives by the directions, ``(F,)`` per rad."""


class NominalScore:
    """S on the table, the sensor as drawn, as an objective."""

    def __init__(self, scorer: TableScorer) -> None:
        self._scorer, self._exact = scorer, Differentiator(scorer)

    def value(self, design: Design) -> float:
        """Return S."""
        return self._scorer.score(design.phi, design.power)

    def gradient(self, design: Design) -> tuple[float, Array]:
        """Return S and its derivatives by the directions."""
        at = self._exact.at(design.phi, design.power)
        return at.score, at.phi


class WeightedSum:
    """The sum of objectives, each with a weight."""

    def __init__(self, *parts: tuple[float, Objective]) -> None:
        self.parts = parts

    def value(self, design: Design) -> float:
        """Return the weighted sum."""
        return sum(weight * part.value(design) for weight, part in self.parts)

    def gradient(self, design: Design) -> tuple[float, Array]:
        """Return the weighted sum and its derivatives."""
        terms = [(weight, part.gradient(design)) for weight, part in self.parts]
        value = sum(weight * term[0] for weight, term in terms)
        return value, np.asarray(sum(weight * term[1] for weight, term in terms))


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
    exact = Differentiator(scorer)
    on = np.zeros(start.drive.shape, dtype=bool)
    if scorer.limits.continuous_power:
        on = start.drive > 0.0

    def gradient(design: Design) -> tuple[float, Array]:
        at = exact.at(design.phi, design.power)
        return at.score, np.concatenate([at.phi, (at.power @ design.palette.matrix.T)[on]])

    first = ScoredDesign(start, scorer.score(start.phi, start.power))
    best, evaluated = _ascend(scorer, first, gradient, on, {"maxiter": MAX_ITERATIONS})
    score = scorer.score(best.design.phi, best.design.power)
    return LocalOptimum(best.design, score, evaluated, time.perf_counter() - began)


def refine_directions(scorer: TableScorer, objective: Objective, start: Design) -> ScoredDesign:
    """Return the best directions near ``start``, with the objective there."""
    first = ScoredDesign(start, objective.value(start))
    powers = np.zeros(start.drive.shape, dtype=bool)
    return _ascend(scorer, first, objective.gradient, powers, DIRECTIONS_OPTIONS)[0]


def multi_start(
    scorer: TableScorer,
    objective: Objective,
    starts: Sequence[Design],
    progress: OnProgress | None = None,
) -> ScoredDesign:
    """Return the best design by ``objective`` within the limits of ``scorer``.

    Directions are improved from every one of ``starts``; then one fiber of the best design after
    the other takes another color, with directions improved anew, as long as that helps.
    """
    optima, clock = [], Clock(len(starts) + 1, progress)
    for start in starts:
        optima.append(refine_directions(scorer, objective, start))
        clock.tick()
    best = max(optima, key=lambda optimum: optimum.score)
    while recolored := _recolored(scorer, objective, best.design):
        refined = refine_directions(scorer, objective, recolored)
        if refined.score <= best.score:
            break
        best = refined
    clock.tick()
    return best


def _recolored(scorer: TableScorer, objective: Objective, design: Design) -> Design | None:
    """Return the best design that another color of one fiber makes, None if none is better."""
    best, best_value = None, objective.value(design)
    for fiber, old in enumerate(design.colors):
        choices = scorer.limits.colors_of(np.arange(scorer.limits.allowed.shape[1]))
        for color in set(choices.tolist()) - {int(old)}:
            colors = design.colors.copy()
            colors[fiber] = color
            if not scorer.limits.fits(colors[None])[0]:
                continue
            candidate = scorer.design(design.phi, colors)
            value = objective.value(candidate)
            if value > best_value:
                best, best_value = candidate, value
    return best


def _ascend(
    scorer: TableScorer,
    start: ScoredDesign,
    gradient: Callable[[Design], tuple[float, Array]],
    on: np.ndarray,
    options: dict[str, float],
) -> tuple[ScoredDesign, int]:
    """Return the best design that L-BFGS-B meets from ``start``, and how many it tries.

    Where it ends on fibers that would meet in their holder, SLSQP (Kraft 1988) climbs from the
    best design so far, with the distances of neighbors as constraints.

    ``gradient`` returns a score and its derivatives by all directions, then by the powers ``on``
    ``(F, color)``, which move too.
    """
    from scipy.optimize import minimize

    low, high = _direction_bounds(scorer, start.design.phi)
    full = np.broadcast_to(scorer.led_power, on.shape)[on]
    fibers, best, evaluated = len(low), start, 1

    def loss(x: Array) -> tuple[float, Array]:
        nonlocal best, evaluated
        drive = start.design.drive.copy()
        drive[on] = np.clip(x[fibers:], 0.0, full)
        design = replace(start.design, phi=np.clip(x[:fibers], low, high), drive=drive)
        score, slopes = gradient(design)
        evaluated += 1
        if score > best.score and scorer.limits.fits_holder(design.phi):
            best = ScoredDesign(design, score)
        return -score, -slopes

    bounds = [*zip(low, high, strict=True), *((0.0, limit) for limit in full)]
    begin = np.concatenate([start.design.phi, start.design.drive[on]])
    end = minimize(loss, begin, jac=True, method="L-BFGS-B", bounds=bounds, options=options).x
    if (holder := scorer.limits.holder) and not scorer.limits.fits_holder(end[:fibers]):
        minimize(
            loss,
            np.concatenate([best.design.phi, best.design.drive[on]]),
            jac=True,
            method="SLSQP",
            bounds=bounds,
            constraints={"type": "ineq", "fun": lambda x: holder.slack(x[:fibers])},
            options={"maxiter": options["maxiter"], "ftol": 1e-7 * max(abs(best.score), 1e-12)},
        )
    return best, evaluated


def _direction_bounds(scorer: TableScorer, phi: Array) -> tuple[Array, Array]:
    """Return the ends of the allowed interval around every direction, ``(F,)`` rad each."""
    limits = scorer.limits
    if limits.step > 0.0:
        return phi, phi
    first, last = scorer.phi_bounds
    inside = (limits.low <= phi[:, None]) & (phi[:, None] <= limits.high)
    interval = inside.argmax(axis=1)[:, None]
    low = np.take_along_axis(limits.low, interval, axis=1)[:, 0]
    high = np.take_along_axis(limits.high, interval, axis=1)[:, 0]
    return np.maximum(low, first), np.minimum(high, last)
