"""Fiber directions by CMA-ES (thesis 4.3.2; Hansen 2016), all free or tied by side and color.

Only directions that a builder can mount are scored: some may be fixed, some forbidden, or in steps.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from optimize.design import Array, Colors, SearchLimits, unlimited
from optimize.scoring import improves
from render.errors import TactiluxError

DirectionScores = Callable[[Array], Array]
"""Scores ``(N,)`` of directions ``(N, F)`` rad."""
HALF_TURN = (0.0, math.pi)
# Standard deviation of the first generation, 20 degrees.
FIRST_STEP = math.radians(20.0)
# The search ends when its steps are this small, 0.1 degrees: far below what can be mounted.
LAST_STEP = math.radians(0.1)
MAX_EVALUATIONS = 20_000


@dataclass(frozen=True, eq=False)
class DirectionResult:
    """The best directions ``phi`` ``(F,)`` rad, and how many candidates were scored.

    ``converged`` is False when the evaluations ran out before the steps became small.
    """

    phi: Array
    score: float
    evaluated: int
    converged: bool


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
    score: DirectionScores,
    start: Array,
    *,
    groups: Colors | None = None,
    bounds: tuple[float, float] = HALF_TURN,
    seed: int = 0,
    max_evaluations: int = MAX_EVALUATIONS,
    limits: SearchLimits | None = None,
    progress: Callable[[int, float], None] | None = None,
) -> DirectionResult:
    """Maximize ``score`` of directions by CMA-ES, from ``start`` ``(F,)`` rad.

    Fibers with a fixed direction are no variables. The others are searched without limits, and
    every candidate is moved to the nearest allowed directions before it is scored (repair by
    projection). Where directions have steps, the result is then improved one step of one fiber at
    a time, unless ``groups`` tie fibers together.

    Arguments:
        score: returns ``(N,)`` for directions ``(N, F)`` rad; anything not finite is an error.
        start: first mean; with groups, the mean over each group.
        groups: ``(F,)`` group of each fiber, 0..G-1, whose fibers share a direction; None: free.
        bounds: directions in rad that ``score`` knows.
        seed: of the search's own random generator; numpy's global one is neither used nor changed.
        max_evaluations: the search ends unconverged when it has scored so many candidates.
        limits: of the directions; none unless given.
        progress: called with evaluations so far and the best score after every generation.

    Raises:
        TactiluxError: the score of some candidate is not finite.
    """
    limits = limits or unlimited(len(start))
    start, free = limits.nearest_directions(start), limits.turned
    if not free.any():
        best = float(score(start[None])[0])
        return DirectionResult(start, best, 1, converged=True)

    def projected(variables: Array) -> Array:
        """Return the allowed directions ``(N, F)`` nearest to those of the free fibers."""
        phi = np.tile(start, (len(variables), 1))
        phi[:, free] = variables
        return limits.nearest_directions(phi)

    member = np.arange(int(free.sum()))
    if groups is not None:
        member = np.unique(groups[free], return_inverse=True)[1]
    count = int(member.max()) + 1
    low, high = bounds
    mean = np.clip(np.bincount(member, weights=start[free]) / np.bincount(member), low, high)
    best_phi = projected(mean[member][None])[0]
    best, evaluated = float(_checked(score, best_phi[None])[0]), 1
    strategy = _strategy(mean, bounds, seed, abs(best))
    while evaluated < max_evaluations and not strategy.stop():
        candidates = strategy.ask()
        phi = projected(np.clip(np.array(candidates)[:, :count], low, high)[:, member])
        scores = _checked(score, phi)
        strategy.tell(candidates, (-scores).tolist())
        evaluated += len(scores)
        leader = int(np.argmax(scores))
        if scores[leader] > best:
            best, best_phi = float(scores[leader]), phi[leader]
        if progress is not None:
            progress(evaluated, best)
    if limits.step > 0.0 and groups is None:
        best_phi, best, tried = _stepwise_ascent(score, best_phi, best, limits)
        evaluated += tried
    return DirectionResult(best_phi, best, evaluated, converged=bool(strategy.stop()))


def _stepwise_ascent(
    score: DirectionScores, phi: Array, best: float, limits: SearchLimits
) -> tuple[Array, float, int]:
    """Return the local optimum that single steps of single fibers reach, and what they cost."""
    free, tried = np.flatnonzero(limits.turned), 0
    while True:
        moved = np.repeat(phi[None], 2 * len(free), axis=0)
        rows = np.arange(len(free))
        moved[rows, free] -= limits.step
        moved[len(free) + rows, free] += limits.step
        moved = limits.nearest_directions(np.clip(moved, 0.0, np.pi))
        scores = np.asarray(score(moved))
        tried += len(scores)
        leader = int(np.argmax(scores))
        if not improves(scores[leader], best):
            return phi, best, tried
        phi, best = moved[leader], float(scores[leader])


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


def _checked(score: DirectionScores, phi: Array) -> Array:
    scores = np.asarray(score(phi), dtype=np.float64)
    bad = ~np.isfinite(scores)
    if bad.any():
        angles = np.degrees(phi[int(np.flatnonzero(bad)[0])]).round(1).tolist()
        raise TactiluxError(
            f"the score of {int(bad.sum())} of {len(scores)} candidates is not finite, the first "
            f"at angles_deg = {angles}, allowed: finite scores; check the table or model behind it",
            field="score",
        )
    return scores
