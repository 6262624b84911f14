"""The thesis's color search (4.3.1): neighbors in pairs, in both phases, then odd groups.

Fibers are numbered around the pad and treated as a ring, so that an even number gives the same
number of pairs in both phases (3^10 assignments each for 20 fibers). With an odd number, the last
fiber (first phase) or the first one (second phase) stands alone. Where pairs have too many
assignments, as those of 48 fibers have, groups are larger.
"""

from __future__ import annotations

import time

import numpy as np

from optimize.design import Array, Colors
from optimize.scoring import TableScorer, improves
from optimize.search.colors.colorings import (
    ColorResult,
    canonical,
    color_units,
    raise_unreachable,
    summed_by_group,
)
from optimize.search.colors.enumeration import Enumeration, Quota

_KEEP = 8
MAX_ASSIGNMENTS = 3**14
"""Of one phase: some seconds of one core; 30 fibers of three colors have half as many in pairs."""


def neighbor_groups(fibers: int, phase: int, size: int = 2) -> Colors:
    """Return the group of each fiber, ``(F,)``: pairs (0 1)(2 3).. or, phase 1, ..(1 2)(3 4)..

    Groups of another ``size`` begin half a group apart in the two phases.

    >>> neighbor_groups(6, 0).tolist(), neighbor_groups(6, 1).tolist()
    ([0, 0, 1, 1, 2, 2], [0, 1, 1, 2, 2, 0])
    >>> neighbor_groups(5, 0).tolist(), neighbor_groups(5, 1).tolist()
    ([0, 0, 1, 1, 2], [0, 1, 1, 2, 2])
    >>> neighbor_groups(8, 0, 4).tolist(), neighbor_groups(8, 1, 4).tolist()
    ([0, 0, 0, 0, 1, 1, 1, 1], [0, 0, 1, 1, 1, 1, 0, 0])
    """
    groups = (np.arange(fibers) + phase * (size // 2)) // size
    return groups % (fibers // size) if fibers % size == 0 else groups


def group_size(fibers: int, choices: int, *, symmetric: bool) -> int:
    """Return how many fibers a group has: two, or more where pairs have too many assignments.

    >>> group_size(30, 3, symmetric=True), group_size(48, 3, symmetric=True)
    (2, 4)
    """
    renamed = choices * (choices - 1) if symmetric and choices > 1 else 1
    size = 2
    while size < fibers:
        most = max(int(neighbor_groups(fibers, phase, size).max()) for phase in (0, 1)) + 1
        if choices**most <= MAX_ASSIGNMENTS * renamed:
            break
        size += 1
    return size


def grouped_colors(scorer: TableScorer, phi: Array) -> ColorResult:
    """Return the best pairwise coloring for ``phi`` ``(F,)`` rad after boundary repair.

    The method is ``coarsely grouped`` where groups are larger than pairs.

    Raises:
        DesignError: no coloring in such groups is within the limits of ``scorer``.
    """
    start = time.perf_counter()
    units = color_units(scorer, phi)
    symmetric = scorer.colors_alike and not scorer.limits.may_be_off
    size = group_size(scorer.fibers, units.shape[1], symmetric=symmetric)
    candidates, evaluated = [], 0
    for phase in (0, 1):
        groups = neighbor_groups(scorer.fibers, phase, size)
        search = Enumeration(
            summed_by_group(units, groups),
            scorer.bends,
            scorer.table.lam,
            scorer.config,
            symmetric=symmetric,
            quota=Quota.of(scorer.limits, groups),
        )
        best = search.best(_KEEP)
        candidates.append(scorer.limits.colors_of(best.choices)[:, groups])
        evaluated += best.evaluated
    pool = np.concatenate(candidates)
    pool = pool[scorer.limits.fits(pool)] if scorer.limits.ties is not None else pool
    if not len(pool):
        raise_unreachable()
    colors = pool[int(np.argmax(scorer.scores(pool, phi)))]
    colors, score, tried = repair_boundaries(scorer, phi, colors)
    return ColorResult(
        method="grouped" if size == 2 else "coarsely grouped",
        colors=canonical(colors) if scorer.colors_alike else colors,
        score=score,
        evaluated=evaluated + len(pool) + tried,
        seconds=time.perf_counter() - start,
    )


def repair_boundaries(scorer: TableScorer, phi: Array, colors: Colors) -> tuple[Colors, float, int]:
    """Move group boundaries by single fibers while that helps, so that odd groups are reached.

    At every boundary between two groups either of its two fibers may take the other's color
    (thesis 4.3.1); the best such change is made until none improves. Returns colors, score and
    the number of colorings tried.
    """
    score, tried = float(scorer.scores(colors[None], phi)[0]), 1
    while True:
        after = np.roll(colors, -1)
        boundary = np.flatnonzero(colors != after)
        if not len(boundary):
            return colors, score, tried
        changed = np.repeat(colors[None], 2 * len(boundary), axis=0)
        rows = np.arange(len(boundary))
        changed[rows, boundary] = after[boundary]
        changed[len(boundary) + rows, (boundary + 1) % len(colors)] = colors[boundary]
        changed = changed[scorer.limits.fits(changed)]
        if not len(changed):
            return colors, score, tried
        scores = scorer.scores(changed, phi)
        tried += len(changed)
        best = int(np.argmax(scores))
        if not improves(scores[best], score):
            return colors, score, tried
        colors, score = changed[best], float(scores[best])
