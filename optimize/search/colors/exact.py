"""The provably best colors: every assignment is scored.

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
)
from optimize.search.colors.enumeration import Enumeration, Quota
from render.errors import TactiluxError
from render.progress import OnProgress

# Best assignments that are scored again in float64 and examined for ties.
KEEP = 128
# 26 fibers take two days at the measured rate.
MAX_FIBERS = 26


def exact_colors(
    scorer: TableScorer,
    phi: Array,
    progress: OnProgress | None = None,
    *,
    device: str | None = None,
) -> ColorResult:
    """Return the best of all ``3^F`` colorings for directions ``phi`` ``(F,)`` rad.

    float32 scores select the best 128, float64 scores order them. Colors are exchangeable unless
    LED powers, materials or limits differ by color; then all ``3^F`` are scored. Ties are those
    that the errors of the table cannot tell from the best; ``ties_complete`` is False when the 128
    kept do not reach beyond them, or beyond the rounding of float32. ``device`` is that of torch;
    None is the processor by a compiled kernel of our own.

    Raises:
        TactiluxError: more fibers than any machine could search.
    """
    start = time.perf_counter()
    if scorer.fibers > MAX_FIBERS:
        raise TactiluxError(
            f"an exact search over {scorer.fibers} fibers would never end, allowed: at most "
            f"{MAX_FIBERS}; use the method quick",
            field="fibers",
            value=scorer.fibers,
        )
    kind = Enumeration
    if device is not None:
        from optimize.search.colors.torch_enumeration import torch_enumeration

        kind = torch_enumeration(device)
    search = kind(
        color_units(scorer, phi),
        scorer.bends,
        scorer.table.lam,
        scorer.config,
        symmetric=scorer.colors_alike,
        quota=Quota.of(scorer.limits),
    )
    best = search.best(KEEP, progress)
    if not len(best.scores):
        raise_unreachable()
    checked = scorer.scores(best.colors, phi)
    rounding = 2.0 * float(np.abs(checked - best.scores).max())
    full = len(best.scores) == KEEP
    crowded = full and checked.max() - best.scores[-1] <= rounding
    colors = canonical(best.colors) if scorer.colors_alike else best.colors
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
