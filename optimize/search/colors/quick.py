"""Fast color search: 2-opt local search from several starts, on superposed light."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from optimize.design import Array, Colors
from optimize.scoring import TableScorer, improves, tied
from optimize.search.colors.colorings import (
    ColorResult,
    canonical,
    color_units,
    ranked,
    summed_by_group,
)
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
        preferences = rng.uniform(size=(restarts, *limits.allowed.shape))
        random = np.array([limits.nearest_colors(row) for row in preferences])
        random = random.reshape(restarts, scorer.fibers)
        starts = [colors for colors in starts if limits.fits(colors[None])[0]]
    else:
        random = rng.integers(0, limits.allowed.shape[1], size=(restarts, scorer.fibers))
    search = _TwoOpt(scorer, phi)
    queue = [np.asarray(colors, dtype=np.int64) for colors in starts]
    queue += list(limits.colors_of(random))
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
    """Best-improvement search; counts are updated by differences, never summed anew.

    Fibers that are tied are one.
    """

    def __init__(self, scorer: TableScorer, phi: Array) -> None:
        from optimize.scoring.metric_kernel import channel_mark, kernel_constants, score_moves

        self.score_moves = score_moves
        self.groups = scorer.limits.groups
        self.first = np.unique(self.groups, return_index=True)[1]
        self.units = summed_by_group(color_units(scorer, phi), self.groups)
        self.bends = scorer.bends
        self.constants = kernel_constants(scorer.config, scorer.table.lam, np.float64)
        self.mark = channel_mark(scorer.channels, np.float64)
        self.choices = self.units.shape[1]
        self.every = np.arange((self.choices - 1) * len(self.units))
        self.limits = scorer.limits
        self.evaluated = 0

    def climb(self, colors: Colors) -> tuple[Colors, float]:
        """Return the local optimum that best-improvement steps from ``colors`` reach."""
        fibers, others = len(self.units), self.choices - 1
        chosen = colors[self.first] % self.choices  # off, -1, is the last choice
        score = -np.inf
        while True:
            counts = np.zeros(self.units.shape[2:])
            for unit, choice in zip(self.units, chosen, strict=True):
                counts += unit[choice]
            # Move f others + s gives fiber f the choice s + 1 further on; the last does nothing.
            change = np.zeros((*counts.shape, others * fibers + 1))
            for fiber in range(fibers):
                unit, old = self.units[fiber], chosen[fiber]
                for step in range(others):
                    new = (old + step + 1) % self.choices
                    change[..., others * fiber + step] = unit[new] - unit[old]
            pairs = self._allowed(chosen)
            scores = self.score_moves(
                counts, change, pairs, self.bends, self.constants, self.mark, _LANES
            )
            self.evaluated += len(scores)
            best = int(np.argmax(scores))
            # Move 0 keeps the colors.
            score = float(scores[0])
            if not improves(scores[best], score):
                return self.limits.colors_of(chosen[self.groups]), score
            chosen = _moved(chosen, pairs[best : best + 1], self.choices)[0]

    def _allowed(self, chosen: Colors) -> NDArray[np.int64]:
        """Return the moves from ``chosen``, which is allowed, that stay within the limits."""
        others = self.choices - 1
        if not self.limits.colors_limited:
            return _together(self.every, others, len(self.every))
        units = np.arange(len(chosen))[:, None]
        allowed, rules = self.limits.of_groups
        new = (chosen[:, None] + np.arange(1, self.choices)) % self.choices
        permitted = self.every[allowed[units, new].ravel()]
        pairs = _together(permitted, others, len(self.every))
        free = rules.most - rules.used(chosen[None])[0]
        for weight, left in zip(rules.weights, free, strict=True):
            more = weight[units, new] - weight[units, chosen[:, None]]
            # The last move, which does nothing, weighs nothing.
            weighs = np.append(more.ravel(), 0)
            pairs = pairs[weighs[pairs[:, 0]] + weighs[pairs[:, 1]] <= left]
        if self.limits.runs is not None:
            moved = self.limits.colors_of(_moved(chosen, pairs, self.choices)[:, self.groups])
            pairs = pairs[self.limits.runs.fit(moved)]
        return np.ascontiguousarray(pairs)


def _moved(chosen: Colors, pairs: NDArray[np.int64], choices: int) -> Colors:
    """Return ``chosen`` ``(F,)`` after each of ``pairs`` ``(N, 2)`` of moves, ``(N, F)``."""
    fibers, rows, others = len(chosen), np.arange(len(pairs)), max(choices - 1, 1)
    steps = np.zeros((len(pairs), fibers + 1), dtype=np.int64)
    for move in pairs.T:
        steps[rows, move // others] = move % others + 1
    return np.asarray((chosen + steps[:, :fibers]) % choices)


def _together(moves: NDArray[np.int64], others: int, nothing: int) -> NDArray[np.int64]:
    """Return ``(n, 2)`` of ``moves`` to make together: none, every one, every two fibers' ones.

    Each fiber has ``others`` moves in a row, and the move ``nothing`` does nothing.
    """
    first, second = np.triu_indices(len(moves), 1)
    first, second = moves[first], moves[second]
    double = np.stack([first, second], axis=1)[first // max(others, 1) != second // max(others, 1)]
    alone = np.stack([moves, np.full(len(moves), nothing)], axis=1)
    return np.concatenate([[[nothing, nothing]], alone, double]).astype(np.int64)
