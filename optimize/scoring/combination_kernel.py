"""S of all lightings that few choices make: compiled, like the kernel of the metric.

A combination chooses places in falling order, at each one of some *ways*, and every choice adds its
unit of light to what those before it left. The lowest choices of several combinations fill the
lanes of `score_lanes`.

Two classes of lightings are such. In one a choice lights a lamp of a ring in a color, and all
others stay off. In the other a choice is where the color changes: all lamps below it take another
one, so that its unit is the difference of two sums of light over all lamps below (prefix sums).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from optimize.scoring.metric_kernel import Indices, Single, score_lanes, vectorized

LANES = 64
"""Lightings that are scored at once."""


@vectorized
def best_combinations(
    base: Single,
    units: Single,
    columns: Single,
    task: Indices,
    rules: Indices,
    led_counts: Indices,
    forbidden: Indices,
    exclusive: np.ndarray,
    bends: int,
    constants: Single,
    mark: tuple[Any, ...],
    threshold: np.float32,
    scores: Single,
    places: Indices,
    colors: Indices,
) -> tuple[int, int]:
    """Keep the best ``len(scores)`` above ``threshold``; return how many, and how many there were.

    ``base`` ``(B * S, K, C)`` are counts before the first choice, ``units`` ``(color before, color,
    place, B * S, K, C)`` what a choice adds, with one color before for all where lamps are lit one
    by one, and ``columns`` the same with places last. A ``task`` is how many choices are made, the
    highest place where it has several, and the color before all. ``rules``: 1 where colors
    change, 0 where lamps are lit; most runs; 1 where colors are alike, so that they appear first in
    their order; the number of lamps. ``led_counts`` ``(color,)`` lamps may have a color, and
    ``forbidden`` ``(color or off, lamp + 1)`` of those below a lamp must not. Of lamps that are
    ``exclusive`` ``(lamp, lamp)`` one may be lit. ``places`` and ``colors`` ``(keep, choice)`` are
    written to, as are ``scores``.
    """
    levels, start = task[0], task[2]
    change, most_runs, alike, lamps = rules[0] == 1, rules[1], rules[2] == 1, rules[3]
    count, evaluated, filled = 0, 0, 0
    ways, here = units.shape[1], units.shape[2]
    sums = np.empty((levels, base.shape[0], base.shape[1], base.shape[2]), base.dtype)
    sums[0] = base
    # Of the choices so far: place, color, the last new color, changes, and lamps of each color.
    place, color = np.full(levels, here), np.full(levels, -1)
    newest, changes = np.full(levels + 1, start if change else -1), np.zeros(levels + 1, np.int64)
    used = np.zeros((levels + 1, ways), np.int64)
    nothing, out = np.zeros_like(base), np.empty(LANES, base.dtype)
    block = np.zeros((base.shape[0], base.shape[1], base.shape[2], LANES), base.dtype)
    lane_places, lane_colors = (
        np.zeros((LANES, levels), np.int64), np.zeros((LANES, levels), np.int64),
    )  # fmt: skip
    valid = np.zeros(LANES, np.bool_)
    level = 0
    if levels > 1:
        place[0] = task[1]
    while level >= 0:
        before = color[level - 1] if level > 0 else start
        row = before if change else 0
        # Lamps from here on are decided: a change at place p is below lamp p + 1.
        above = lamps if level == 0 else place[level - 1] + change
        if level == levels - 1:
            high = here if level == 0 else place[level - 1]
            for new in range(ways):
                if alike and new > newest[level] + 1:
                    continue
                if change:
                    if new == before or (levels == most_runs and new != start):
                        continue
                else:
                    first = color[0] if level > 0 else new
                    turns = changes[level] + (level > 0 and new != before) + (new != first)
                    if max(turns, 1) > most_runs or used[level, new] >= led_counts[new]:
                        continue
                low = 0
                while low < high:
                    count_here = min(high - low, LANES - filled)
                    _fill(block, filled, sums[level], columns[row, new], low, count_here)
                    for lane in range(count_here):
                        at = low + lane
                        if change:
                            fits = _may_have(
                                forbidden, led_counts, used[level], before, at + 1, above
                            ) and _may_have(forbidden, led_counts, used[level], new, 0, at + 1)
                        else:
                            fits = (
                                forbidden[new, at + 1] == forbidden[new, at]
                                and forbidden[ways, above] == forbidden[ways, at + 1]
                                and forbidden[ways, at] == 0
                                and not exclusive[at, place[:level]].any()
                            )
                        evaluated += fits
                        valid[filled + lane] = fits
                        lane_places[filled + lane, :level] = place[:level]
                        lane_colors[filled + lane, :level] = color[:level]
                        lane_places[filled + lane, level] = at
                        lane_colors[filled + lane, level] = new
                    filled += count_here
                    low += count_here
                    if filled == LANES:
                        score_lanes(nothing, block, bends, constants, mark, out)
                        count, threshold = _kept(
                            out, valid, lane_places, lane_colors, count, threshold, scores, places,
                            colors,
                        )  # fmt: skip
                        filled = 0
            level -= 1
            continue
        color[level] += 1
        if color[level] == ways:
            color[level] = 0
            place[level] -= 1
            if level == 0 or place[level] < levels - 1 - level:
                level -= 1
                continue
        at, new = place[level], color[level]
        if at < levels - 1 - level:
            level -= 1
            continue
        if alike and new > newest[level] + 1:
            continue
        used[level + 1] = used[level]
        if change:
            if new == before:
                continue
            if not _may_have(forbidden, led_counts, used[level], before, at + 1, above):
                continue
            used[level + 1, before] += above - at - 1
        else:
            if forbidden[new, at + 1] != forbidden[new, at] or used[level, new] >= led_counts[new]:
                continue
            if forbidden[ways, above] != forbidden[ways, at + 1]:
                continue
            if exclusive[at, place[:level]].any():
                continue
            used[level + 1, new] += 1
            changes[level + 1] = changes[level] + (level > 0 and new != before)
            if changes[level + 1] > most_runs:
                continue
        newest[level + 1] = max(newest[level], new)
        unit = units[row, new, at]
        for cell in range(base.shape[0]):
            for facet in range(base.shape[1]):
                for channel in range(base.shape[2]):
                    sums[level + 1, cell, facet, channel] = (
                        sums[level, cell, facet, channel] + unit[cell, facet, channel]
                    )
        level += 1
        place[level], color[level] = place[level - 1] - 1, -1
    if filled:
        valid[filled:] = False
        score_lanes(nothing, block, bends, constants, mark, out)
        count, threshold = _kept(
            out, valid, lane_places, lane_colors, count, threshold, scores, places, colors
        )
    return count, evaluated


@vectorized
def _fill(block: Single, filled: int, base: Single, columns: Single, low: int, count: int) -> None:
    """Write the counts of ``count`` lightings from place ``low`` on into lanes of ``block``."""
    for cell in range(base.shape[0]):
        for facet in range(base.shape[1]):
            for channel in range(base.shape[2]):
                here = base[cell, facet, channel]
                for lane in range(count):
                    block[cell, facet, channel, filled + lane] = (
                        here + columns[cell, facet, channel, low + lane]
                    )


@vectorized
def _kept(
    out: Single,
    valid: np.ndarray,
    lane_places: Indices,
    lane_colors: Indices,
    count: int,
    threshold: np.float32,
    scores: Single,
    places: Indices,
    colors: Indices,
) -> tuple[int, np.float32]:
    """Keep the best of the scored lanes; return how many are kept, and what a better one beats."""
    for lane in range(len(out)):
        if valid[lane] and out[lane] > threshold:
            kept = count
            if count < len(scores):
                count += 1
            else:
                kept = int(np.argmin(scores))
            scores[kept] = out[lane]
            places[kept], colors[kept] = lane_places[lane], lane_colors[lane]
            if count == len(scores):
                threshold = max(threshold, scores.min())
    return count, threshold


@vectorized
def _may_have(
    forbidden: Indices, led_counts: Indices, used: Indices, color: int, low: int, high: int
) -> bool:
    """Return whether the lamps from ``low`` to below ``high`` may all have a color."""
    if forbidden[color, high] != forbidden[color, low]:
        return False
    return bool(used[color] + high - low <= led_counts[color])
