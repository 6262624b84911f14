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
    sizes = np.bincount(limits.groups)
    fibers, least = len(sizes), int(sizes.min())
    leds = limits.led_counts[: len(limits.palette.names)] // least
    lamps = len(limits.allowed) if limits.most_lit is None else limits.most_lit
    top = min(fibers, int(leds.sum()), lamps // least)
    found, total = [], 0
    for lit in range(1 if limits.may_be_off else fibers, top + 1):
        ways = math.comb(fibers, lit)
        patterns = list(itertools.islice(_patterns(lit, leds.tolist(), alike), most // ways + 1))
        total += ways * len(patterns)
        if total > most:
            return None
        places = np.array(list(itertools.combinations(range(fibers), lit)))
        for pattern in patterns:
            colors = np.full((ways, fibers), DARK)
            np.put_along_axis(colors, places, np.array(pattern)[None], axis=1)
            found.append(colors)
    if not found:
        return np.empty((0, len(limits.allowed)), dtype=np.int64)
    every = np.concatenate(found)[:, limits.groups]
    return every[limits.fits(every)]


def _patterns(lit: int, left: list[int], alike: bool) -> Iterator[tuple[int, ...]]:
    """Yield the colors of so many lit lamps in a row, with so many LEDs ``left`` of each color.

    Where colors are ``alike`` they appear first in their order.
    """
    chosen: list[int] = []

    def extended() -> Iterator[tuple[int, ...]]:
        if len(chosen) == lit:
            yield tuple(chosen)
            return
        new = max(chosen, default=-1) + 1
        for color, count in enumerate(left):
            if chosen.count(color) < count and (not alike or color <= new):
                chosen.append(color)
                yield from extended()
                chosen.pop()

    yield from extended()
