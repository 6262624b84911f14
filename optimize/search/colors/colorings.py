"""What every color search works on and returns: light by color, and the symmetry of colors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NoReturn

import numpy as np

from optimize.design import DARK, Array, Colors
from optimize.scoring import TableScorer
from render.errors import DesignError


@dataclass(frozen=True, eq=False)
class ColorResult:
    """The best colors that a search found on one transport table.

    Arguments:
        method: ``grouped``, ``coarsely grouped``, ``quick`` or ``exact``.
        colors: ``(F,)``, indices of the palette, -1 for off.
        score: S of eq. (4.7) in counts, float64.
        evaluated: how many assignments were scored.
        seconds: wall time.
        ties: other colorings that the table's error bars cannot tell from the best, best first;
            a coloring that only exchanges color names is not another one.
        ties_complete: False when there may be more ties than a search keeps.
        top: the best colorings that the search kept, best first, with their float64 scores.
    """

    method: str
    colors: Colors
    score: float
    evaluated: int
    seconds: float
    ties: tuple[tuple[int, ...], ...] = ()
    ties_complete: bool = True
    top: tuple[tuple[tuple[int, ...], float], ...] = ()

    @property
    def monochrome(self) -> bool:
        """Whether one color lights everything: then hue says nothing, and lam is too large."""
        return len(set(self.colors.tolist())) == 1


def canonical(colors: Colors) -> Colors:
    """Return ``colors`` ``(..., F)`` renamed in the order in which they first appear; off stays.

    M depends on colors through norms and distances only, so renaming them changes no score as
    long as each has a channel of its own and none its own material or LED power.
    """
    flat = colors.reshape(-1, colors.shape[-1])
    renamed = np.empty_like(flat)
    for row, names in zip(renamed, flat, strict=True):
        lit = dict.fromkeys(name for name in names.tolist() if name != DARK)
        order = {name: index for index, name in enumerate(lit)} | {DARK: DARK}
        row[:] = [order[name] for name in names.tolist()]
    return renamed.reshape(colors.shape)


def ranked(colors: Colors, scores: Array) -> tuple[tuple[tuple[int, ...], float], ...]:
    """Return ``colors`` ``(N, F)``, best first, with their ``scores`` ``(N,)``, as plain data."""
    pairs = zip(colors.tolist(), scores.tolist(), strict=True)
    return tuple((tuple(row), score) for row, score in pairs)


def renamed_like(colors: Colors, reference: Colors, count: int = 3) -> Colors:
    """Return ``colors`` of ``count`` renamed so that most fibers keep their color of ``reference``.

    Off stays off.
    """
    return np.where(colors == DARK, DARK, names_like(colors, reference, count)[colors])


def names_like(colors: Colors, reference: Colors, count: int) -> Colors:
    """Return the new name of each of ``count`` colors, see `renamed_like`.

    An assignment problem; of equally good names the first in order are taken.
    """
    from scipy.optimize import linear_sum_assignment

    # Digits of less than one fiber prefer names in their order.
    place = np.arange(count)
    shared = -0.5 / count * place / np.power(float(count), place)[:, None]
    both = (colors != DARK) & (reference != DARK)
    np.add.at(shared, (colors[both], reference[both]), 1.0)
    return np.asarray(linear_sum_assignment(shared, maximize=True)[1])


def raise_unreachable() -> NoReturn:
    """Say that a search found no coloring within its limits."""
    raise DesignError(
        "no choice of colors of this search fulfills the constraints: fix fewer fibers, allow "
        "more LEDs per color, or use the method quick",
        field="constraints",
    )


def color_units(scorer: TableScorer, phi: Array) -> Array:
    """Return the counts ``(F, choice, B * S, K, C)`` that each fiber adds with each color.

    Choices are the colors of the palette, then off where that is one.
    """
    light = scorer.light(phi)
    if not scorer.table.by_channel:
        light = light[..., None]
    light = light.reshape(scorer.fibers, 1, -1, scorer.facets, light.shape[-1])
    units = light * scorer.led_power[:, :, None, None, None]
    units = units * scorer.palette.matrix[:, None, None, :]
    dark = int(scorer.limits.may_be_off)
    return np.pad(units, [(0, 0), (0, dark), (0, 0), (0, 0), (0, 0)])


def summed_by_group(units: Array, groups: Colors) -> Array:
    """Return the units of whole groups, ``(G, n, B * S, K, C)``; ``groups`` has 0..G-1."""
    if np.array_equal(groups, np.arange(len(units))):
        return units
    sums = np.zeros((int(groups.max()) + 1, *units.shape[1:]))
    np.add.at(sums, groups, units)
    return sums
