"""What every colour search returns, and the symmetry of colours."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from optimize.design.design import Array, Colours


@dataclass(frozen=True, eq=False)
class ColourResult:
    """The best colours that a search found on one transport table.

    Arguments:
        method: ``grouped``, ``quick`` or ``exact``.
        colours: ``(F,)``, 0/1/2 = R/G/B.
        score: S of eq. (4.7) in counts, float64.
        evaluated: how many assignments were scored.
        seconds: wall time.
        ties: other colourings that the table's error bars cannot tell from the best, best first;
            a colouring that only exchanges colour names is not another one.
        ties_complete: False when there may be more ties than a search keeps.
        top: the best colourings that the search kept, best first, with their float64 scores.
    """

    method: str
    colours: Colours
    score: float
    evaluated: int
    seconds: float
    ties: tuple[tuple[int, ...], ...] = ()
    ties_complete: bool = True
    top: tuple[tuple[tuple[int, ...], float], ...] = ()

    @property
    def monochrome(self) -> bool:
        """Whether one colour lights everything: then hue says nothing, and lam is too large."""
        return len(set(self.colours.tolist())) == 1


def canonical(colours: Colours) -> Colours:
    """Return ``colours`` ``(..., F)`` renamed in the order in which they first appear.

    M depends on colours through norms and distances only, so renaming them changes no score as
    long as no channel has its own material or LED power.
    """
    flat = colours.reshape(-1, colours.shape[-1])
    renamed = np.empty_like(flat)
    for row, names in zip(renamed, flat, strict=True):
        order = {name: index for index, name in enumerate(dict.fromkeys(names.tolist()))}
        row[:] = [order[name] for name in names.tolist()]
    return renamed.reshape(colours.shape)


def ranked(colours: Colours, scores: Array) -> tuple[tuple[tuple[int, ...], float], ...]:
    """Return ``colours`` ``(N, F)``, best first, with their ``scores`` ``(N,)``, as plain data."""
    pairs = zip(colours.tolist(), scores.tolist(), strict=True)
    return tuple((tuple(row), score) for row, score in pairs)


def renamed_like(colours: Colours, reference: Colours) -> Colours:
    """Return ``colours`` renamed so that most fibers keep their colour of ``reference``."""
    names = [np.array(order) for order in itertools.permutations(range(3))]
    return max((order[colours] for order in names), key=lambda new: int((new == reference).sum()))
