"""Gradient polish: from a good design to the nearest local optimum, by exact derivatives.

L-BFGS-B (Byrd et al. 1995) over the directions and, where the builder allows it, over the power of
every LED that is on. S has kinks where facets clip; the best design met on the way is kept.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from optimize.design.design import Array, Design
from optimize.scoring.score_gradient import Differentiator
from optimize.scoring.table_scorer import TableScorer

STEPS = 200


@dataclass(frozen=True, eq=False)
class PolishResult:
    """The polished design, its score, and how many designs were scored in which time."""

    design: Design
    score: float
    evaluated: int
    seconds: float


def polish(scorer: TableScorer, start: Design, *, steps: int = STEPS) -> PolishResult:
    """Return the local optimum near ``start``, within the limits of ``scorer``.

    Directions move inside the allowed interval that they start in; where directions have steps
    they stay as they are. Powers move only if the limits say that they are continuous, and only
    those of LEDs that are on.
    """
    from scipy.optimize import minimize

    began = time.perf_counter()
    limits, exact = scorer.limits, Differentiator(scorer)
    low, high = direction_room(scorer, start.phi)
    on = (start.power > 0.0) if limits.continuous_power else np.zeros(start.power.shape, dtype=bool)
    most = np.broadcast_to(scorer.led_power, start.power.shape)[on]
    fibers = len(start.phi)
    best, best_score, evaluated = start, scorer.score(start.phi, start.power), 1

    def design(x: Array) -> Design:
        power = start.power.copy()
        power[on] = np.clip(x[fibers:], 0.0, most)
        return Design(np.clip(x[:fibers], low, high), power)

    def loss(x: Array) -> tuple[float, Array]:
        nonlocal best, best_score, evaluated
        tried = design(x)
        found = exact.at(tried.phi, tried.power)
        evaluated += 1
        if found.score > best_score:
            best, best_score = tried, found.score
        return -found.score, -np.concatenate([found.phi, found.power[on]])

    bounds = [*zip(low, high, strict=True), *((0.0, limit) for limit in most)]
    minimize(
        loss,
        np.concatenate([start.phi, start.power[on]]),
        jac=True,
        method="L-BFGS-B",
        bounds=bounds,
        options={"maxiter": steps},
    )
    score = scorer.score(best.phi, best.power)
    return PolishResult(best, score, evaluated, time.perf_counter() - began)


def direction_room(scorer: TableScorer, phi: Array) -> tuple[Array, Array]:
    """Return the bounds of every direction, ``(F,)`` rad each."""
    limits = scorer.limits
    if limits.step > 0.0:
        return phi, phi
    first, last = scorer.phi_bounds
    inside = (limits.low <= phi[:, None]) & (phi[:, None] <= limits.high)
    own = inside.argmax(axis=1)[:, None]
    low = np.take_along_axis(limits.low, own, axis=1)[:, 0]
    high = np.take_along_axis(limits.high, own, axis=1)[:, 0]
    return np.maximum(low, first), np.minimum(high, last)
