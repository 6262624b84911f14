"""The provably best colors: every assignment is scored.

The thesis called this infeasible (4.3.1: 3^20 assignments). Superposition, the symmetry of colors
(a sixth remains) and vector instructions make it minutes.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import NoReturn

import numpy as np

from optimize.design.design import Array, Colors
from optimize.scoring.score_noise import tied
from optimize.scoring.table_scorer import TableScorer
from optimize.search.colors.enumeration import Enumeration, SearchProgress
from optimize.search.colors.quota import Quota
from optimize.search.colors.result import ColorResult, canonical, ranked
from render.errors import DesignError, TactiluxError

# Best assignments that are scored again in float64 and examined for ties.
KEEP = 128
# 26 fibers take two days at the measured rate.
MAX_FIBERS = 26


def exact_colors(
    scorer: TableScorer,
    phi: Array,
    progress: Callable[[SearchProgress], None] | None = None,
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
    found = search.best(KEEP, progress)
    if not len(found.scores):
        raise_unreachable()
    checked = scorer.scores(found.colors, phi)
    rounding = 2.0 * float(np.abs(checked - found.scores).max())
    full = len(found.scores) == KEEP
    crowded = full and checked.max() - found.scores[-1] <= rounding
    colors = canonical(found.colors) if scorer.colors_alike else found.colors
    colors = np.unique(colors, axis=0)
    scores = scorer.scores(colors, phi)
    order = np.argsort(-scores, kind="stable")
    colors, scores = colors[order], scores[order]
    same = tied(scorer, phi, scorer.power(colors))
    return ColorResult(
        method="exact",
        colors=colors[0],
        score=scorer.score(phi, scorer.power(colors[0])),
        evaluated=found.evaluated,
        seconds=time.perf_counter() - start,
        ties=tuple(tuple(row.tolist()) for row in colors[1:][same[1:]]),
        ties_complete=not (crowded or (full and same.all())),
        top=ranked(colors, scores),
    )


def raise_unreachable() -> NoReturn:
    """Say that a search found no coloring within its limits."""
    raise DesignError(
        "no choice of colors of this search fulfills the constraints: fix fewer fibers, allow "
        "more LEDs per color, or use the method quick",
        field="constraints",
    )


def color_units(scorer: TableScorer, phi: Array) -> Array:
    """Return the counts ``(F, 3, B * S, K)`` that each fiber adds to a channel of its color."""
    light = scorer.light(phi)
    if not scorer.table.by_channel:
        light = light[..., None]
    light = np.moveaxis(light, -1, 1)
    light = light.reshape(scorer.fibers, light.shape[1], -1, scorer.facets)
    return np.asarray(light * scorer.led_power[:, :, None, None])


def grouped_units(units: Array, groups: Colors) -> Array:
    """Return the units of whole groups, ``(G, 3, B * S, K)``; ``groups`` ``(F,)`` holds 0..G-1."""
    sums = np.zeros((int(groups.max()) + 1, *units.shape[1:]))
    np.add.at(sums, groups, units)
    return sums
