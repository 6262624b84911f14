"""Fast color search: 2-opt local search from several starts, on superposed light."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from optimize.design import Array, Colors
from optimize.scoring import TableScorer, improves, tied
from optimize.search.colors.colorings import ColorResult, canonical, color_units, ranked
from render.progress import Clock, OnProgress

RESTARTS = 24
_LANES = 128


def quick_colors(
    scorer: TableScorer,
    phi: Array,
    *,
    starts: Sequence[Colors] = (),
    restarts: int = RESTARTS,
    seed: int = 0,
    progress: OnProgress | None = None,
) -> ColorResult:
    """Return the best local optimum for ``phi`` ``(F,)`` rad.

    A local optimum is a coloring that neither recoloring one fiber nor recoloring any two
    (which includes swaps) improves. Searches start from ``starts`` and from ``restarts`` random
    colorings of ``seed``. ``progress`` is told of every start. All are within
    the limits of ``scorer``; starts that are not are left out.
    """
    start = time.perf_counter()
    rng = np.random.default_rng(seed)
    limits = scorer.limits
    if limits.colors_limited:
        # Random preferences make random allowed colorings.
        preferences = rng.uniform(size=(restarts, scorer.fibers, 3))
        random = np.array([limits.nearest_colors(row) for row in preferences])
        random = random.reshape(restarts, -1)
        starts = [colors for colors in starts if limits.fits(colors[None])[0]]
    else:
        random = rng.integers(0, 3, size=(restarts, scorer.fibers))
    search = _TwoOpt(scorer, phi)
    queue = [np.asarray(colors, dtype=np.int64) for colors in starts] + list(random)
    optima: dict[tuple[int, ...], float] = {}
    clock = Clock(len(queue), progress)
    for colors in queue:
        optimum, score = search.climb(colors)
        key = canonical(optimum) if scorer.colors_alike else optimum
        optima[tuple(key.tolist())] = score
        clock.tick()
    order = np.array(sorted(optima, key=lambda key: -optima[key]), dtype=np.int64)
    same = tied(scorer, phi, scorer.power(order))
    return ColorResult(
        method="quick",
        colors=order[0],
        score=scorer.score(phi, scorer.power(order[0])),
        evaluated=search.evaluated,
        seconds=time.perf_counter() - start,
        ties=tuple(tuple(row.tolist()) for row in order[1:][same[1:]]),
        top=ranked(order, scorer.scores(order, phi)),
    )


class _TwoOpt:
    """Best-improvement search; counts are updated by differences, never summed anew."""

    def __init__(self, scorer: TableScorer, phi: Array) -> None:
        from optimize.scoring.metric_kernel import kernel_constants, score_moves

        self.score_moves = score_moves
        self.units = color_units(scorer, phi)
        self.bends = scorer.bends
        self.constants = kernel_constants(scorer.config, scorer.table.lam, np.float64)
        self.pairs = _moves(scorer.fibers)
        self.limits = scorer.limits
        self.evaluated = 0

    def climb(self, colors: Colors) -> tuple[Colors, float]:
        """Return the local optimum that best-improvement steps from ``colors`` reach."""
        fibers = len(self.units)
        score = -np.inf
        while True:
            counts = np.zeros((*self.units.shape[2:], 3))
            for unit, color in zip(self.units, colors, strict=True):
                counts[..., color] += unit[color]
            # Move 2 f + s gives fiber f the color s + 1 further on; the last one does nothing.
            change = np.zeros((*counts.shape, 2 * fibers + 1))
            for fiber in range(fibers):
                old = colors[fiber]
                for step in (0, 1):
                    new = (old + step + 1) % 3
                    change[..., old, 2 * fiber + step] = -self.units[fiber, old]
                    change[..., new, 2 * fiber + step] = self.units[fiber, new]
            pairs = self._allowed(colors)
            scores = self.score_moves(counts, change, pairs, self.bends, self.constants, _LANES)
            self.evaluated += len(scores)
            best = int(np.argmax(scores))
            # Move 0 keeps the colors.
            score = float(scores[0])
            if not improves(scores[best], score):
                return colors, score
            colors = _moved(colors, pairs[best : best + 1])[0]

    def _allowed(self, colors: Colors) -> NDArray[np.int64]:
        """Return the moves from ``colors`` that stay within the limits."""
        if not self.limits.colors_limited:
            return self.pairs
        return np.ascontiguousarray(self.pairs[self.limits.fits(_moved(colors, self.pairs))])


def _moved(colors: Colors, pairs: NDArray[np.int64]) -> Colors:
    """Return ``colors`` ``(F,)`` after each of ``pairs`` ``(N, 2)`` of moves, ``(N, F)``."""
    fibers, rows = len(colors), np.arange(len(pairs))
    steps = np.zeros((len(pairs), fibers + 1), dtype=np.int64)
    for move in pairs.T:
        steps[rows, move // 2] = move % 2 + 1
    return np.asarray((colors + steps[:, :fibers]) % 3)


def _moves(fibers: int) -> NDArray[np.int64]:
    """Return ``(n, 2)`` moves to make together: none, every single one, every two fibers' ones."""
    nothing = 2 * fibers
    single = [(move, nothing) for move in range(2 * fibers)]
    double = [
        (first, second)
        for first in range(2 * fibers)
        for second in range(first - first % 2 + 2, 2 * fibers)
    ]
    return np.array([(nothing, nothing), *single, *double], dtype=np.int64)
