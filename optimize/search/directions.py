"""Fiber directions by CMA-ES (thesis 4.3.2), all free or tied by side and color."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from optimize.design.design import Array, Colors
from optimize.design.limits import Limits
from render.errors import TactiluxError

BatchScore = Callable[[Array], Array]
HALF_TURN = (0.0, math.pi)
# Standard deviation of the first generation, 20 degrees.
FIRST_STEP = math.radians(20.0)
# The search ends when its steps are this small, 0.1 degrees: far below what can be mounted.
LAST_STEP = math.radians(0.1)
MAX_EVALUATIONS = 20_000


@dataclass(frozen=True, eq=False)
class DirectionResult:
    """The best directions found.

    Arguments:
        phi: ``(F,)`` rad.
        score: its score.
        evaluated: how many candidates were scored.
        seconds: wall time.
        converged: False when the evaluations ran out before the steps became small.
        history: ``(evaluated, best score so far)`` after every generation.
    """

    phi: Array
    score: float
    evaluated: int
    seconds: float
    converged: bool
    history: tuple[tuple[int, float], ...]


def tied_groups(edges: Sequence[str], colors: Colors) -> Colors:
    """Return the group of each fiber, ``(F,)``: fibers of one side and color share a direction.

    >>> tied_groups(["left", "left", "tip", "tip"], np.array([0, 2, 2, 2])).tolist()
    [0, 1, 2, 2]
    """
    keys = list(zip(edges, colors.tolist(), strict=True))
    order = {key: index for index, key in enumerate(dict.fromkeys(keys))}
    return np.array([order[key] for key in keys], dtype=np.int64)


def population(dimensions: int) -> int:
    """Return the candidates per generation, ``4 + 3 ln n`` (Hansen 2016, table 1)."""
    return 4 + int(3 * math.log(max(dimensions, 2)))


def optimize_directions(
    score: BatchScore,
    start: Array,
    *,
    groups: Colors | None = None,
    bounds: tuple[float, float] = HALF_TURN,
    seed: int = 0,
    max_evaluations: int = MAX_EVALUATIONS,
    limits: Limits | None = None,
    progress: Callable[[int, float], None] | None = None,
) -> DirectionResult:
    """Maximize ``score`` of directions by CMA-ES, from ``start`` ``(F,)`` rad.

    Arguments:
        score: returns ``(N,)`` for directions ``(N, F)`` rad; anything not finite is an error.
        start: first mean; with groups, the mean over each group.
        groups: ``(F,)`` group of each fiber, 0..G-1, whose fibers share a direction; None: free.
        bounds: allowed directions in rad.
        seed: of the own random generator; numpy's global one is neither used nor changed.
        max_evaluations: the search ends unconverged when it has scored so many candidates.
        limits: candidates are moved to the nearest allowed directions before they are scored.
        progress: called with evaluations so far and the best score after every generation.

    Raises:
        TactiluxError: the score of some candidate is not finite.
    """
    if limits is not None and limits.directions_limited:
        from optimize.search.limited_directions import limited_directions

        return limited_directions(
            score,
            start,
            limits,
            groups=groups,
            bounds=bounds,
            seed=seed,
            max_evaluations=max_evaluations,
            progress=progress,
        )
    began = time.perf_counter()
    member = np.arange(len(start)) if groups is None else groups
    count = int(member.max()) + 1
    low, high = bounds
    mean = np.bincount(member, weights=start) / np.bincount(member)
    best_phi = np.clip(mean, low, high)[member]
    best, evaluated = float(_checked(score, best_phi[None])[0]), 1
    history = [(evaluated, best)]
    strategy = _strategy(np.clip(mean, low, high), bounds, seed, abs(best))
    while evaluated < max_evaluations and not strategy.stop():
        candidates = strategy.ask()
        phi = np.clip(np.array(candidates)[:, :count], low, high)[:, member]
        scores = _checked(score, phi)
        strategy.tell(candidates, (-scores).tolist())
        evaluated += len(scores)
        leader = int(np.argmax(scores))
        if scores[leader] > best:
            best, best_phi = float(scores[leader]), phi[leader]
        history.append((evaluated, best))
        if progress is not None:
            progress(evaluated, best)
    return DirectionResult(
        phi=best_phi,
        score=best,
        evaluated=evaluated,
        seconds=time.perf_counter() - began,
        converged=bool(strategy.stop()),
        history=tuple(history),
    )


def _strategy(mean: Array, bounds: tuple[float, float], seed: int, scale: float) -> Any:
    import cma

    rng = np.random.default_rng(seed)
    # CMA-ES needs two dimensions; a second one that nothing depends on does no harm.
    start = np.append(mean, np.mean(bounds)) if len(mean) == 1 else mean
    options = {
        "bounds": list(bounds),
        "randn": lambda *shape: rng.standard_normal(shape),
        "seed": math.nan,  # leaves numpy's global generator alone
        "tolx": LAST_STEP,
        "tolfun": 1e-7 * max(scale, 1e-300),
        "tolfunhist": 1e-9 * max(scale, 1e-300),
        "verbose": -9,
        "verb_log": 0,
        "verb_disp": 0,
    }
    return cma.CMAEvolutionStrategy(start, min(FIRST_STEP, (bounds[1] - bounds[0]) / 4), options)


def _checked(score: BatchScore, phi: Array) -> Array:
    scores = np.asarray(score(phi), dtype=np.float64)
    bad = ~np.isfinite(scores)
    if bad.any():
        angles = np.degrees(phi[int(np.flatnonzero(bad)[0])]).round(1).tolist()
        raise TactiluxError(
            f"the score of {int(bad.sum())} of {len(scores)} candidates is not finite, the first "
            f"at angles_deg = {angles}, allowed: finite scores; check the table or model behind it",
            field="score",
            value=float(scores[bad][0]),
        )
    return scores
