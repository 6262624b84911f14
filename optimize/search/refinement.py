"""Designs that are best by another measure than S on the table: with tolerances, with shadows.

Behind a diffuser the directions of one coloring have a single optimum (measured: nine starts of
finger20 agree to 1e-6), so exact derivatives find it in some ten steps. That makes it affordable
to give every promising coloring its own best directions.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from optimize.design.design import Array, Design
from optimize.scoring.table_scorer import TableScorer
from optimize.search.polish import direction_room

STEPS = 60


class Objective(Protocol):
    """What is maximized, in counts."""

    def value(self, design: Design) -> float:
        """Return the objective."""

    def gradient(self, design: Design) -> tuple[float, Array]:
        """Return the objective and its derivatives by the directions, ``(F,)`` per rad."""


class Weighted:
    """The sum of objectives, each with a weight."""

    def __init__(self, *parts: tuple[float, Objective]) -> None:
        """Keep the parts."""
        self.parts = parts

    def value(self, design: Design) -> float:
        """Return the weighted sum."""
        return sum(weight * part.value(design) for weight, part in self.parts)

    def gradient(self, design: Design) -> tuple[float, Array]:
        """Return the weighted sum and its derivatives."""
        found = [(weight, part.gradient(design)) for weight, part in self.parts]
        value = sum(weight * entry[0] for weight, entry in found)
        return value, np.asarray(sum(weight * entry[1] for weight, entry in found))


def refine(
    scorer: TableScorer,
    objective: Objective,
    starts: Sequence[Design],
    progress: Callable[[int, int], None] | None = None,
) -> tuple[Design, float]:
    """Return the best design by ``objective`` within the limits of ``scorer``, and its value.

    Directions are improved from every one of ``starts``; then one fiber of the best design after
    the other takes another color, with directions improved anew, as long as that helps.
    """
    found = []
    for done, start in enumerate(starts):
        found.append(turned(scorer, objective, start))
        if progress is not None:
            progress(done + 1, len(starts) + 1)
    best, value = max(found, key=lambda entry: entry[1])
    while better := recolored(scorer, objective, best):
        moved = turned(scorer, objective, better)
        if moved[1] <= value:
            break
        best, value = moved
    if progress is not None:
        progress(len(starts) + 1, len(starts) + 1)
    return best, value


def turned(scorer: TableScorer, objective: Objective, start: Design) -> tuple[Design, float]:
    """Return the best directions near ``start`` by L-BFGS-B, and the objective there."""
    from scipy.optimize import minimize

    low, high = direction_room(scorer, start.phi)
    best, best_value = start, objective.value(start)

    def loss(x: Array) -> tuple[float, Array]:
        nonlocal best, best_value
        design = Design(np.clip(x, low, high), start.power)
        value, slope = objective.gradient(design)
        if value > best_value:
            best, best_value = design, value
        return -value, -slope

    bounds = list(zip(low, high, strict=True))
    options = {"maxiter": STEPS, "ftol": 1e-7}
    minimize(loss, start.phi, jac=True, method="L-BFGS-B", bounds=bounds, options=options)
    return best, best_value


def recolored(scorer: TableScorer, objective: Objective, design: Design) -> Design | None:
    """Return the best design that another color of one fiber makes, None if none is better."""
    best, value = None, objective.value(design)
    for fiber, old in enumerate(design.colors):
        for color in set(range(3)) - {int(old)}:
            colors = design.colors.copy()
            colors[fiber] = color
            if (colors < 0).any() or not scorer.limits.fits(colors[None])[0]:
                continue
            moved = Design(design.phi, scorer.power(colors))
            found = objective.value(moved)
            if found > value:
                best, value = moved, found
    return best
