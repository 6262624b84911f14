"""All allowed colorings, where few lamps are lit or there are few: a class that can be proven."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator

import numpy as np

from optimize.design import DARK, Colors, SearchLimits


def all_colorings(limits: SearchLimits, most: int, *, alike: bool) -> Colors | None:
    """Return every coloring ``(N, F)`` within ``limits``, None where there may be over ``most``.

    Each lights some lamp. Where colors are ``alike``, those that only exchange them count once.
    Lamps that are tied have one color.

    >>> from dataclasses import replace
    >>> from optimize.design import unlimited
    >>> one_of_three = replace(unlimited(3, off=True), most_lit=1)
    >>> all_colorings(one_of_three, 9, alike=True).tolist()
    [[0, -1, -1], [-1, 0, -1], [-1, -1, 0]]
    """
    palette, (choices, _) = limits.palette, limits.of_groups
    allowed, sizes = choices[:, : len(palette.names)], np.bincount(limits.groups)
    fibers, least = len(sizes), int(sizes.min())
    taken = np.bincount(palette.led, allowed.any(axis=0), palette.led_count) > 0
    leds = limits.led_counts[: palette.led_count] * taken // least
    # Of lamps that are tied, runs are counted at the end.
    given = limits.runs if limits.ties is None else None
    ring, runs = (np.arange(fibers), fibers) if given is None else (given.ring, given.most)
    usable = ring[np.asarray(allowed.any(axis=1))[ring]]
    lamps = len(limits.allowed) if limits.most_lit is None else limits.most_lit
    top = min(len(usable), int(leds.sum()), lamps // least)
    left = (leds[palette.led] * allowed.any(axis=0)).tolist()
    found, total = [], 0
    for lit in range(1 if limits.may_be_off else fibers, top + 1):
        ways = math.comb(len(usable), lit)
        patterns = list(itertools.islice(_patterns(lit, left, runs, alike), most // ways + 1))
        total += ways * len(patterns)
        if total > most:
            return None
        places = np.array(list(itertools.combinations(usable.tolist(), lit)))
        for pattern in patterns:
            colors = np.full((ways, fibers), DARK)
            np.put_along_axis(colors, places, np.array(pattern)[None], axis=1)
            found.append(colors)
    if not found:
        return np.empty((0, len(limits.allowed)), dtype=np.int64)
    every = np.concatenate(found)[:, limits.groups]
    return every[limits.fits(every)]


def _patterns(lit: int, left: list[int], runs: int, alike: bool) -> Iterator[tuple[int, ...]]:
    """Yield the colors of so many lit lamps in a ring, with so many LEDs ``left`` of each color.

    There are at most so many ``runs`` of one color. Where colors are ``alike`` they appear first in
    their order.
    """
    chosen: list[int] = []
    changes = [0]

    def extended() -> Iterator[tuple[int, ...]]:
        if len(chosen) == lit:
            yield tuple(chosen)
            return
        new = max(chosen, default=-1) + 1
        for color, count in enumerate(left):
            if chosen.count(color) == count or (alike and color > new):
                continue
            changed = changes[-1] + (bool(chosen) and color != chosen[-1])
            closed = changed + (len(chosen) + 1 == lit and color != (chosen or [color])[0])
            if closed <= runs:
                chosen.append(color)
                changes.append(changed)
                yield from extended()
                chosen.pop()
                changes.pop()

    yield from extended()
