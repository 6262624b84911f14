"""Classes of colorings that builders can wire, scored as a whole: few lamps lit, or few runs.

Where lamps may be off: every choice of places for so many lit lamps, in all colors. Where all are
lit: every coloring of the ring with so many runs of one color, by sums of light over all lamps
below a place. Either combines few choices (`optimize.scoring.combination_kernel`), float32, of
which the best are scored again in float64.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

import numpy as np

from optimize.design import Array, Colors, SearchLimits
from optimize.search.colors.enumeration import BestAssignments, check_range, workers
from render.metric import MetricConfig
from render.progress import Clock, OnProgress

if TYPE_CHECKING:
    from optimize.scoring.metric_kernel import Single

MOST_COMBINATIONS = 10**9
"""Colorings of a class that is scored as a whole; half an hour of two cores for three states."""


def are_combinations(limits: SearchLimits) -> bool:
    """Return whether all colorings within ``limits`` are combinations of few choices.

    Lamps that are tied, budgets and several shots are no part of a combination.
    """
    alone = limits.ties is None and limits.palette.shots == 1
    few = limits.some_stay_off or limits.runs_limited
    apart = limits.exclusive is None or limits.may_be_off
    return alone and not limits.budgets and few and apart


def count_combinations(limits: SearchLimits, *, alike: bool) -> int:
    """Return how many colorings there are within ``limits``, but for those of single lamps.

    Each lights some lamp. Where colors are ``alike``, those that only exchange them count once.

    >>> from dataclasses import replace
    >>> from optimize.design import unlimited
    >>> count_combinations(replace(unlimited(34, off=True), most_lit=3), alike=True)
    31076
    """
    fibers, colors = len(limits.allowed), len(limits.palette.names)
    runs = fibers if limits.runs is None else min(limits.runs.most, fibers)
    # (first color, last color, newest color): colorings of a row, by changes.
    rows = {(color, color, color): 1 for color in range(1 if alike else colors)}
    if not limits.may_be_off:
        total = len(rows)
        for changes in range(1, min(runs, fibers - 1) + 1):
            rows = _changed(rows, colors, alike=alike)
            closed = changes == runs
            patterns = sum(n for (first, last, _), n in rows.items() if first == last or not closed)
            total += math.comb(fibers - 1, changes) * patterns
        return total
    led_counts = tuple(limits.led_counts[:colors].tolist())
    top = fibers if limits.most_lit is None else min(fibers, limits.most_lit)
    top, total = min(top, sum(led_counts)), 0
    for lit in range(1, top + 1):
        free = _by_runs(lit, runs, colors, alike=alike)
        total += math.comb(fibers, lit) * min(free, _by_counts(lit, led_counts))
        if total > 10**18:
            break
    return total


def _changed(
    rows: dict[tuple[int, int, int], int], colors: int, *, alike: bool
) -> dict[tuple[int, int, int], int]:
    """Return the colorings of rows with one more change of color."""
    found: dict[tuple[int, int, int], int] = {}
    for (first, last, newest), ways in rows.items():
        for color in range(min(colors, newest + 2) if alike else colors):
            if color != last:
                key = first, color, max(newest, color)
                found[key] = found.get(key, 0) + ways
    return found


def _by_runs(lit: int, runs: int, colors: int, *, alike: bool) -> int:
    """Return the colorings of a ring of so many lit lamps with at most so many runs."""
    rows = {(color, color, color): 1 for color in range(1 if alike else colors)}
    total = len(rows)
    for changes in range(1, min(runs, lit - 1) + 1):
        rows = _changed(rows, colors, alike=alike)
        patterns = sum(n for (first, last, _), n in rows.items()
                       if changes + (first != last) <= runs)  # fmt: skip
        total += math.comb(lit - 1, changes) * patterns
    return total


def _by_counts(lit: int, led_counts: tuple[int, ...]) -> int:
    """Return the colorings of a row of so many lit lamps, of each color no more than there are."""
    ways = [1] + [0] * lit
    for count in led_counts:
        ways = [
            sum(math.comb(n, own) * ways[n - own] for own in range(min(n, count) + 1))
            for n in range(lit + 1)
        ]
    return ways[lit]


class Combinations:
    """All colorings within the ``limits`` of few lit lamps or few runs.

    Arguments of the constructor:
        units: counts ``(F, choice, B * S, K, C)`` that each lamp adds with each color.
        limits: of the colorings, see `are_combinations`.
        bends: number of bends B.
        lam, config: of the metric.
        alike: colors may be renamed, so that they count once.
    """

    def __init__(
        self,
        units: Array,
        limits: SearchLimits,
        bends: int,
        lam: float,
        config: MetricConfig,
        *,
        alike: bool,
    ) -> None:
        from optimize.scoring.metric_kernel import channel_mark, kernel_constants

        self.limits, self.alike, self.bends = limits, alike, bends
        self.fibers, self.colors = len(units), len(limits.palette.names)
        self.ring = np.arange(self.fibers) if limits.runs is None else limits.runs.ring
        self.runs = self.fibers if limits.runs is None else min(limits.runs.most, self.fibers)
        self.by_change = not limits.may_be_off
        check_range(units)
        lit = np.moveaxis(units[self.ring, : self.colors], 0, 1)
        self._whole = lit.sum(axis=1)
        if self.by_change:
            below = np.cumsum(lit, axis=1)[:, :-1]
            added = below[None] - below[:, None]
        else:
            added = lit[None]
        self._units = added.astype(np.float32)
        self._columns = np.ascontiguousarray(np.moveaxis(self._units, 2, -1))
        allowed = limits.allowed[self.ring]
        if self.by_change:
            allowed = np.pad(allowed, [(0, 0), (0, 1)])
        near = np.zeros((self.fibers, self.fibers), bool) if limits.exclusive is None else (
            limits.exclusive
        )  # fmt: skip
        self._exclusive = np.ascontiguousarray(near[np.ix_(self.ring, self.ring)])
        self._forbidden = np.zeros((self.colors + 1, self.fibers + 1), np.int64)
        self._forbidden[:, 1:] = np.cumsum(~allowed.T, axis=1)
        self._led_counts = limits.led_counts[: self.colors].astype(np.int64)
        self._constants = kernel_constants(config, lam, np.float32)
        self._mark = channel_mark(units.shape[-1], np.float32)

    def best(self, keep: int, progress: OnProgress | None = None) -> BestAssignments:
        """Return the ``keep`` best colorings of all, as choices: a color, or after them off."""
        tasks = list(self._tasks())
        clock = Clock(sum(self._cost(*task) for task in tasks), progress)
        scores, chosen = self._of_one_color()
        evaluated, cores = len(scores), workers()
        with ThreadPoolExecutor(cores) as pool:
            for first in range(0, len(tasks), 8 * cores):
                batch = tasks[first : first + 8 * cores]
                order = np.argsort(-scores, kind="stable")[:keep]
                scores, chosen = scores[order], chosen[order]
                least = scores[-1] if len(scores) == keep else np.float32(-np.inf)
                for part in pool.map(lambda task, t=least: self._task(task, keep, t), batch):
                    scores = np.concatenate([scores, part[0]])
                    chosen = np.concatenate([chosen, part[1]])
                    evaluated += part[2]
                clock.tick(sum(self._cost(*task) for task in batch))
        order = np.lexsort((*chosen.T[::-1], -scores))[:keep]
        return BestAssignments(chosen[order], scores[order], evaluated)

    def _tasks(self) -> Iterator[tuple[int, int, int]]:
        """Yield choices of a combination, its highest place, and the color before all."""
        places = self._units.shape[2]
        if self.by_change:
            starts = range(1 if self.alike else self.colors)
            counts = range(1, min(self.runs, self.fibers - 1) + 1) if self.runs > 1 else range(0)
        else:
            most = self.fibers if self.limits.most_lit is None else self.limits.most_lit
            starts, counts = range(-1, 0), range(1, min(most, self.fibers) + 1)
        for count in counts:
            tops = [places] if count == 1 else range(count - 1, places)
            yield from ((count, top, start) for top in tops for start in starts)

    def _cost(self, count: int, top: int, _: int) -> int:
        return math.comb(top, count - 1) * self.colors**count if count > 1 else top * self.colors

    def _task(self, task: tuple[int, int, int], keep: int, least: np.float32) -> tuple[
        Single, Colors, int
    ]:  # fmt: skip
        from optimize.scoring.combination_kernel import best_combinations

        count, _, start = task
        base = self._whole[start] if self.by_change else np.zeros(self._whole.shape[1:])
        scores = np.empty(keep, np.float32)
        places, colors = (np.empty((keep, count), np.int64) for _ in range(2))
        rules = np.array([self.by_change, self.runs, self.alike, self.fibers], np.int64)
        found, evaluated = best_combinations(
            base.astype(np.float32), self._units, self._columns, np.array(task, np.int64), rules,
            self._led_counts, self._forbidden, self._exclusive, self.bends, self._constants,
            self._mark, least, scores, places, colors,
        )  # fmt: skip
        chosen = np.full((found, self.fibers), start if self.by_change else self.colors)
        for choice in range(count):
            at, new = places[:found, choice, None], colors[:found, choice, None]
            number = np.arange(self.fibers)
            chosen = np.where(number <= at if self.by_change else number == at, new, chosen)
        return scores[:found], self._in_order(chosen), evaluated

    def _of_one_color(self) -> tuple[Single, Colors]:
        """Return score and choices of the colorings without a change, where all lamps are lit."""
        from optimize.scoring.metric_kernel import score_lanes

        names = range(1 if self.alike else self.colors) if self.by_change else ()
        fit = [color for color in names if not self._forbidden[color, -1]
               and self._led_counts[color] >= self.fibers]  # fmt: skip
        scores = np.empty(len(fit), np.float32)
        for number, color in enumerate(fit):
            base, out = self._whole[color].astype(np.float32), np.empty(16, np.float32)
            score_lanes(base, np.zeros((*base.shape, 16), np.float32), self.bends,
                        self._constants, self._mark, out)  # fmt: skip
            scores[number] = out[0]
        return scores, np.repeat(np.array(fit, np.int64)[:, None], self.fibers, axis=1)

    def _in_order(self, chosen: Colors) -> Colors:
        """Return choices in the order of the lamps' numbers."""
        found = np.empty_like(chosen)
        found[:, self.ring] = chosen
        return found
