"""CMA-ES over the directions that a builder can mount: some fixed, some forbidden, in steps."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from optimize.design.design import Array, Colors
from optimize.design.limits import Limits
from optimize.search.directions import BatchScore, DirectionResult, optimize_directions

_ROUNDING = 1e-12


def limited_directions(
    score: BatchScore,
    start: Array,
    limits: Limits,
    *,
    groups: Colors | None,
    bounds: tuple[float, float],
    seed: int,
    max_evaluations: int,
    progress: Callable[[int, float], None] | None,
) -> DirectionResult:
    """Return the best allowed directions found; arguments as in `optimize_directions`.

    Fixed fibers are no variables. The others are searched without limits, and every candidate is
    moved to the nearest allowed directions before it is scored (repair by projection). Where
    directions have steps, the result is then improved one step of one fiber at a time, unless
    ``groups`` tie fibers together.
    """
    began = time.perf_counter()
    start, free = limits.nearest_directions(start), ~limits.mounted

    def whole(part: Array) -> Array:
        phi = np.tile(start, (*part.shape[:-1], 1))
        phi[..., free] = part
        return limits.nearest_directions(phi)

    if not free.any():
        best = float(score(start[None])[0])
        spent = time.perf_counter() - began
        return DirectionResult(start, best, 1, spent, converged=True, history=((1, best),))
    member = None if groups is None else np.unique(groups[free], return_inverse=True)[1]
    found = optimize_directions(
        lambda part: score(whole(part)),
        start[free],
        groups=member,
        bounds=bounds,
        seed=seed,
        max_evaluations=max_evaluations,
        progress=progress,
    )
    phi, best, evaluated = whole(found.phi), found.score, found.evaluated
    if limits.step > 0.0 and groups is None:
        phi, best, tried = _climb(score, phi, best, limits)
        evaluated += tried
    return replace(
        found,
        phi=phi,
        score=best,
        evaluated=evaluated,
        seconds=time.perf_counter() - began,
        history=(*found.history, (evaluated, best)),
    )


def _climb(score: BatchScore, phi: Array, best: float, limits: Limits) -> tuple[Array, float, int]:
    """Return the local optimum that single steps of single fibers reach, and what they cost."""
    free, tried = np.flatnonzero(~limits.mounted), 0
    while True:
        moved = np.repeat(phi[None], 2 * len(free), axis=0)
        rows = np.arange(len(free))
        moved[rows, free] -= limits.step
        moved[len(free) + rows, free] += limits.step
        moved = limits.nearest_directions(np.clip(moved, 0.0, np.pi))
        scores = np.asarray(score(moved))
        tried += len(scores)
        leader = int(np.argmax(scores))
        if scores[leader] <= best + _ROUNDING * abs(best):
            return phi, best, tried
        phi, best = moved[leader], float(scores[leader])
