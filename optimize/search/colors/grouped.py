"""The thesis's colour search (4.3.1): neighbours in pairs, in both phases, then odd groups.

Fibers are numbered around the pad and treated as a ring, so that an even number gives the same
number of pairs in both phases (3^10 assignments each for 20 fibers). With an odd number, the last
fiber (first phase) or the first one (second phase) stands alone.
"""

from __future__ import annotations

import time

import numpy as np

from optimize.design.design import Array, Colours
from optimize.scoring.evaluate import TableScorer
from optimize.search.colors.enumeration import Enumeration
from optimize.search.colors.exact import colour_units, grouped_units, raise_unreachable
from optimize.search.colors.quota import Quota
from optimize.search.colors.result import ColourResult, canonical

_KEEP = 8
# Scores closer than this (relative) are the same number with other roundings.
_ROUNDING = 1e-12


def pair_groups(fibers: int, phase: int) -> Colours:
    """Return the group of each fiber, ``(F,)``: pairs (0 1)(2 3).. or, phase 1, ..(1 2)(3 4)..

    >>> pair_groups(6, 0).tolist(), pair_groups(6, 1).tolist()
    ([0, 0, 1, 1, 2, 2], [0, 1, 1, 2, 2, 0])
    >>> pair_groups(5, 0).tolist(), pair_groups(5, 1).tolist()
    ([0, 0, 1, 1, 2], [0, 1, 1, 2, 2])
    """
    groups = (np.arange(fibers) + phase) // 2
    return groups % (fibers // 2) if fibers % 2 == 0 else groups


def grouped_colours(scorer: TableScorer, phi: Array) -> ColourResult:
    """Return the best pairwise colouring for ``phi`` ``(F,)`` rad after boundary repair.

    Raises:
        DesignError: no colouring in pairs is within the limits of ``scorer``.
    """
    start = time.perf_counter()
    units = colour_units(scorer, phi)
    candidates, evaluated = [], 0
    for phase in (0, 1):
        groups = pair_groups(scorer.fibers, phase)
        search = Enumeration(
            grouped_units(units, groups),
            scorer.bends,
            scorer.table.lam,
            scorer.config,
            symmetric=scorer.colours_alike,
            quota=Quota.of(scorer.limits, groups),
        )
        found = search.best(_KEEP)
        candidates.append(found.colours[:, groups])
        evaluated += found.evaluated
    pool = np.concatenate(candidates)
    if not len(pool):
        raise_unreachable()
    colours = pool[int(np.argmax(scorer.scores(pool, phi)))]
    colours, score, tried = repair_boundaries(scorer, phi, colours)
    return ColourResult(
        method="grouped",
        colours=canonical(colours) if scorer.colours_alike else colours,
        score=score,
        evaluated=evaluated + len(pool) + tried,
        seconds=time.perf_counter() - start,
    )


def repair_boundaries(
    scorer: TableScorer, phi: Array, colours: Colours
) -> tuple[Colours, float, int]:
    """Move group boundaries by single fibers while that helps, so that odd groups are reached.

    At every boundary between two groups either of its two fibers may take the other's colour
    (thesis 4.3.1); the best such change is made until none improves. Returns colours, score and
    the number of colourings tried.
    """
    score, tried = float(scorer.scores(colours[None], phi)[0]), 1
    while True:
        after = np.roll(colours, -1)
        boundary = np.flatnonzero(colours != after)
        if not len(boundary):
            return colours, score, tried
        changed = np.repeat(colours[None], 2 * len(boundary), axis=0)
        rows = np.arange(len(boundary))
        changed[rows, boundary] = after[boundary]
        changed[len(boundary) + rows, (boundary + 1) % len(colours)] = colours[boundary]
        changed = changed[scorer.limits.fits(changed)]
        if not len(changed):
            return colours, score, tried
        scores = scorer.scores(changed, phi)
        tried += len(changed)
        best = int(np.argmax(scores))
        if scores[best] <= score + _ROUNDING * abs(score):
            return colours, score, tried
        colours, score = changed[best], float(scores[best])
