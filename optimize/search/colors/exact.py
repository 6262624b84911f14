"""The provably best colors: every assignment is scored, or every one with few lamps or few runs.

The thesis called this infeasible (4.3.1: 3^20 assignments). Superposition, the symmetry of colors
(a sixth remains) and vector instructions make it minutes.
"""

from __future__ import annotations

import time

import numpy as np

from optimize.design import Array
from optimize.scoring import TableScorer, tied
from optimize.search.colors.colorings import (
    ColorResult,
    canonical,
    color_units,
    raise_unreachable,
    ranked,
    summed_by_group,
)
from optimize.search.colors.combinations import (
    MOST_COMBINATIONS,
    Combinations,
    are_combinations,
    count_combinations,
)
from optimize.search.colors.enumeration import Enumeration, Quota
from render.errors import TactiluxError
from render.progress import OnProgress

# Best assignments that are scored again in float64 and examined for ties.
KEEP = 128
# Of three colors that may be renamed; 26 fibers take two days at the measured rate.
MAX_COLORINGS = 3**26


def exact_colors(
    scorer: TableScorer, phi: Array, progress: OnProgress | None = None
) -> ColorResult:
    """Return the best of all ``n^F`` colorings for directions ``phi`` ``(F,)`` rad.

    Where the limits leave few lamps lit or few runs of one color, it is the best of all those.
    float32 scores select the best 128, float64 scores order them. Colors are exchangeable unless
    responses, LED powers, materials or limits differ by color, or off is a choice; then all ``n^F``
    are scored. Ties are those that the errors of the table cannot tell from the best;
    ``ties_complete`` is False when the 128 kept do not reach beyond them, or beyond the rounding of
    float32.

    Raises:
        TactiluxError: more than any machine could search.
    """
    start = time.perf_counter()
    groups = scorer.limits.groups
    units = summed_by_group(color_units(scorer, phi), groups)
    search = (
        _combinations(scorer, units)
        if are_combinations(scorer.limits)
        else _enumeration(scorer, units)
    )
    best = search.best(KEEP, progress)
    if not len(best.scores):
        raise_unreachable()
    found = scorer.limits.colors_of(best.choices)[:, groups]
    checked = scorer.scores(found, phi)
    rounding = 2.0 * float(np.abs(checked - best.scores).max())
    full = len(best.scores) == KEEP
    crowded = full and checked.max() - best.scores[-1] <= rounding
    colors = canonical(found) if scorer.colors_alike else found
    colors = np.unique(colors, axis=0)
    scores = scorer.scores(colors, phi)
    order = np.argsort(-scores, kind="stable")
    colors, scores = colors[order], scores[order]
    same = tied(scorer, phi, scorer.power(colors))
    return ColorResult(
        method="exact",
        colors=colors[0],
        score=scorer.score(phi, scorer.power(colors[0])),
        evaluated=best.evaluated,
        seconds=time.perf_counter() - start,
        ties=tuple(tuple(row.tolist()) for row in colors[1:][same[1:]]),
        ties_complete=not (crowded or (full and same.all())),
        top=ranked(colors, scores),
    )


def _enumeration(scorer: TableScorer, units: Array) -> Enumeration:
    """Return the search of all colorings, or of all that are within limits of single lamps."""
    if scorer.limits.runs_limited:
        raise TactiluxError(
            "an exact search of few runs takes lamps of one shot that are not tied, without a "
            "budget; use the method quick",
            field="search.runs",
        )
    choices, most = units.shape[1], 1
    while choices > 1 and choices ** (most + 1) <= MAX_COLORINGS:
        most += 1
    if choices > 1 and len(units) > most:
        raise TactiluxError(
            f"an exact search over {len(units)} fibers of {choices} choices each would never "
            f"end, allowed: at most {most}; use the method quick",
            field="fibers",
        )
    return Enumeration(
        units,
        scorer.bends,
        scorer.table.lam,
        scorer.config,
        symmetric=scorer.colors_alike and not scorer.limits.may_be_off,
        quota=Quota.of(scorer.limits, scorer.limits.groups),
    )


def _combinations(scorer: TableScorer, units: Array) -> Combinations:
    """Return the search of all colorings with few lit lamps or few runs."""
    limits, alike = scorer.limits, scorer.colors_alike
    total = count_combinations(limits, alike=alike)
    if total > MOST_COMBINATIONS:
        raise TactiluxError(
            f"an exact search of all designs{limits.words} would score {total:,}, allowed: at most "
            f"{MOST_COMBINATIONS:,}; allow fewer, or use the method quick",
            field="search",
        )
    return Combinations(units, limits, scorer.bends, scorer.table.lam, scorer.config, alike=alike)
