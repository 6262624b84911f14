"""All color assignments of some light sources, scored as fast as the processor allows.

Light adds up, so an assignment's counts are the sum of three shorter ones: a *prefix* (one task
per prefix), a *middle* and a *suffix*. All n^4 middles and n^5 suffixes of n choices are summed
once; an assignment then costs one addition per count before the metric. Suffixes are the lanes of
the kernel. Scores are float32: callers score the few best again in float64.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from optimize.design import Array, Colors, LinearRules, SearchLimits
from render.errors import TableError
from render.metric import MetricConfig
from render.progress import Clock, OnProgress

if TYPE_CHECKING:
    from optimize.scoring.metric_kernel import Single

# Measured best: 2 million assignments per second and core with 3 bends, 15 sites, 10 facets.
SUFFIX, MIDDLE, LANES = 5, 4, 64
_TASKS_PER_ROUND = 24
_SUFFIX_BYTES = 64 * 2**20


@dataclass(frozen=True, eq=False)
class BestAssignments:
    """The ``keep`` best assignments, best first, and how many were scored.

    Arguments:
        choices: ``(keep, unit)``, 0 to n - 1.
        scores: ``(keep,)`` float32.
        evaluated: number of assignments scored.
    """

    choices: Colors
    scores: Single
    evaluated: int


@dataclass(frozen=True, eq=False)
class Quota:
    """SearchLimits of colorings, by unit.

    Arguments:
        allowed: ``(U, choice)`` which choices each unit may have.
        rules: what the choices of all units together keep to.
    """

    allowed: NDArray[np.bool_]
    rules: LinearRules

    @classmethod
    def open(cls, units: int, choices: int) -> Quota:
        """Return the quota that allows everything."""
        none = np.empty((0, units, choices), dtype=np.int64)
        return cls(np.ones((units, choices), dtype=bool), LinearRules(none, none[:, 0, 0]))

    @classmethod
    def of(cls, limits: SearchLimits, groups: Colors | None = None) -> Quota:
        """Return the quota of ``limits`` for fibers, or for whole ``groups`` ``(F,)``, 0..G-1."""
        fibers = len(limits.allowed)
        member = np.arange(fibers) if groups is None else groups
        count = int(member.max()) + 1
        allowed = np.stack([limits.allowed[member == unit].all(axis=0) for unit in range(count)])
        return cls(allowed, limits.rules.of_groups(member))

    @property
    def choices(self) -> int:
        """How many colors there are, off among them where that is one."""
        return int(self.allowed.shape[1])

    @property
    def limited(self) -> bool:
        """Whether anything is forbidden."""
        return bool(not self.allowed.all() or len(self.rules.most))

    def codes(self, start: int, stop: int) -> Colors:
        """Return the base-n codes of all colorings of units ``start`` to ``stop`` that fit."""
        count = stop - start
        codes: Colors = np.arange(self.choices**count, dtype=np.int64)
        if not self.limited or not count:
            return codes
        chosen = digits(codes, count, self.choices)
        fits = self.allowed[np.arange(start, stop), chosen].all(axis=1)
        fits &= (self.used(codes, start, stop) <= self.rules.most).all(axis=1)
        return codes[fits]

    def used(self, codes: Colors, start: int, stop: int) -> Colors:
        """Return what codes of units ``start`` to ``stop`` weigh by each rule, ``(N, rule)``."""
        part = LinearRules(self.rules.weights[:, start:stop], self.rules.most)
        return part.used(digits(codes, stop - start, self.choices))


class Enumeration:
    """All ``n^U`` assignments of ``units``, the counts ``(U, n, B * S, K, C)`` of every choice.

    Arguments:
        units: counts added to every channel by unit u when it has color c.
        bends: number of bends B.
        symmetric: all choices are colors that may be renamed, so only assignments that start with
            color 0 and continue with color 1 are scored (of three colors a sixth of all).
        quota: what colors units may have; all unless given.
    """

    def __init__(
        self,
        units: Array,
        bends: int,
        lam: float,
        config: MetricConfig,
        *,
        symmetric: bool,
        quota: Quota | None = None,
    ) -> None:
        from optimize.scoring.metric_kernel import kernel_constants

        check_range(units)
        self.units, self.bends, self.symmetric = len(units), bends, symmetric
        self.lam, self.config = lam, config
        self.constants = kernel_constants(config, lam, np.float32)
        self.choices, size = units.shape[1], 4 * units[0, 0].size
        suffix = _most_units(min(self.units, SUFFIX), self.choices, size)
        middle = _most_units(min(self.units - suffix, MIDDLE), self.choices, size)
        self.prefix = self.units - suffix - middle
        self.quota = quota or Quota.open(self.units, self.choices)
        first, second = self.prefix, self.prefix + middle
        self._all_suffixes: int = self.choices**suffix
        self._codes = self.quota.codes(first, second), self.quota.codes(second, self.units)
        self._used = tuple(
            self.quota.used(codes, start, stop)
            for codes, start, stop in zip(
                self._codes, (first, second), (second, self.units), strict=True
            )
        )
        self.middles, self.suffixes = map(len, self._codes)
        # float64 sums, rounded once: (assignment, cell, facet, channel).
        self._prefix_units = units[:first]
        self._middle = _all_sums(units[first:second])[self._codes[0]].astype(np.float32)
        self._blocks = _lane_blocks(_all_sums(units[second:])[self._codes[1]])

    @property
    def total(self) -> int:
        """Number of assignments that are scored."""
        if self.quota.limited:
            return sum(1 for _ in self._prefix_codes()) * self.middles * self.suffixes
        tasks = sum(1 for _ in self._prefix_codes()) if self.symmetric else self._all_prefixes
        return tasks * self.middles * self.suffixes

    def best(
        self,
        keep: int,
        progress: OnProgress | None = None,
        limit: int | None = None,
    ) -> BestAssignments:
        """Return the ``keep`` best assignments of all, or of the first tasks up to ``limit``."""
        clock = Clock(self.total, progress)
        scores, codes, done = np.empty(0, np.float32), np.empty(0, np.int64), 0
        tasks = iter(self._prefix_codes())
        per_task, cores = self.middles * self.suffixes, workers()
        with ThreadPoolExecutor(cores) as pool:
            while batch := list(itertools.islice(tasks, cores * _TASKS_PER_ROUND)):
                threshold = scores[-1] if len(scores) == keep else np.float32(-np.inf)
                parts = list(pool.map(lambda code, t=threshold: self._task(code, keep, t), batch))
                scores = np.concatenate([scores, *(part[0] for part in parts)])
                codes = np.concatenate([codes, *(part[1] for part in parts)])
                order = np.lexsort((codes, -scores))[:keep]
                scores, codes = scores[order], codes[order]
                done += len(batch) * per_task
                clock.tick(len(batch) * per_task)
                if limit is not None and done >= limit:
                    break
        return BestAssignments(digits(codes, self.units, self.choices), scores, done)

    def _prefix_codes(self) -> Iterable[int]:
        if self.quota.limited and self.prefix:
            return map(int, self.quota.codes(0, self.prefix))
        if not (self.symmetric and self.prefix):
            return range(self._all_prefixes)
        # Base-n numbers below n^(p-1) start with color 0; those in [n^j, 2 n^j) continue with 1.
        base = self.choices
        ranges = (range(base**j, min(2, base) * base**j) for j in range(self.prefix - 1))
        return itertools.chain([0], *ranges)

    @property
    def _all_prefixes(self) -> int:
        return int(self.choices**self.prefix)

    def _task(self, code: int, keep: int, threshold: np.float32) -> tuple[Single, Colors]:
        chosen = digits(np.array([code]), self.prefix, self.choices)[0]
        base = np.zeros(self._middle.shape[1:])
        for unit, color in enumerate(chosen):
            base += self._prefix_units[unit, color]
        used = self.quota.used(np.array([code]), 0, self.prefix)[0]
        free = self.quota.rules.most - used
        scores, codes = self.best_of_tile(base.astype(np.float32), free, keep, threshold)
        middle, suffix = np.divmod(codes, self.suffixes)
        whole = self._codes[0][middle] * self._all_suffixes + self._codes[1][suffix]
        below = self.choices ** (self.units - self.prefix)
        return scores, whole + code * below

    def best_of_tile(
        self, base: Single, free: Colors, keep: int, threshold: np.float32
    ) -> tuple[Single, Colors]:
        """Return scores and codes of the best assignments above ``threshold`` on top of ``base``.

        Codes are ``middle * suffixes + suffix``, unsorted, ``keep`` at most; ``free`` ``(rule,)``
        is what they may still weigh.
        """
        from optimize.scoring.metric_kernel import best_of_tile, channel_mark

        scores, codes = np.empty(keep, np.float32), np.empty(keep, np.int64)
        count = best_of_tile(
            base,
            self._middle,
            self._blocks,
            self.suffixes,
            self.bends,
            self.constants,
            channel_mark(base.shape[-1], np.float32),
            threshold,
            free,
            self._used[0],
            self._used[1],
            scores,
            codes,
        )
        return scores[:count], codes[:count]


def workers() -> int:
    """Return how many tasks run at once: as many as the process has cores."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on every operating system
        return os.cpu_count() or 1


def check_range(units: Array) -> None:
    """Refuse counts that float32 cannot hold.

    Raises:
        TableError: the light of a fiber is too much.
    """
    with np.errstate(over="ignore"):
        single = units.astype(np.float32)
    if not np.isfinite(single).all():
        raise TableError(
            "the light of a fiber exceeds the range of float32 counts, allowed: below 3e38; "
            "check the table's exposure",
            field="exposure",
        )


def _all_sums(units: Array) -> Array:
    """Return the counts ``(n^U, B * S, K, C)`` of all assignments of ``units``."""
    sums = np.zeros((1, *units.shape[2:]))
    for unit in units:
        sums = (sums[:, None] + unit).reshape(-1, *sums.shape[1:])
    return sums


def _most_units(units: int, choices: int, size: int) -> int:
    """Return how many of ``units`` are summed at once, ``size`` bytes per sum; at least one."""
    while units > 1 and choices**units * size > _SUFFIX_BYTES:
        units -= 1
    return units


def _lane_blocks(sums: Array) -> Single:
    """Return ``sums`` ``(n, B * S, K, C)`` as ``(block, B * S, K, C, lane)``, padded with zeros."""
    lanes = min(LANES, max(16, -(-len(sums) // 16) * 16))
    blocks = -(-len(sums) // lanes)
    padded = np.zeros((blocks * lanes, *sums.shape[1:]), np.float32)
    padded[: len(sums)] = sums
    parts = padded.reshape(blocks, lanes, *sums.shape[1:])
    return np.ascontiguousarray(np.moveaxis(parts, 1, -1))


def digits(codes: Colors, count: int, base: int = 3) -> Colors:
    """Return ``count`` digits of each code, the first unit's most significant."""
    powers = base ** np.arange(count - 1, -1, -1, dtype=np.int64)
    return np.asarray(codes[:, None] // powers % base, dtype=np.int64)
