"""Rank agreement between predicted and rendered scores, over the pairs that renders can decide."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from optimize.design import Array


@dataclass(frozen=True)
class RankAgreement:
    """Kendall's tau over decided pairs.

    Arguments:
        tau: ``(concordant - discordant) / decided``; None when no pair is decided.
        decided: pairs whose rendered difference is beyond its 95 % interval.
        pairs: all pairs.
    """

    tau: float | None
    decided: int
    pairs: int

    @property
    def shown(self) -> str:
        """The agreement in words."""
        if self.tau is None:
            return f"none of {self.pairs} pairs is decided by the renders"
        return f"tau {self.tau:.2f} over {self.decided} of {self.pairs} pairs"


def rank_agreement(
    predicted: Array, interval: Callable[[int, int], tuple[float, float]]
) -> RankAgreement:
    """Return how well ``predicted`` scores ``(design,)`` rank the designs.

    A pair whose rendered difference lies within its error bars says nothing about the ranking and
    is left out (Kendall 1938, over the remaining pairs); a predicted tie counts as neither.

    Arguments:
        predicted: scores.
        interval: 95 % interval of the rendered score of design j minus that of design i.
    """
    count, total, decided = len(predicted), 0, 0
    for i in range(count):
        for j in range(i + 1, count):
            low, high = interval(i, j)
            rendered = 1 if low > 0 else -1 if high < 0 else 0
            if rendered:
                decided += 1
                gain = float(predicted[j] - predicted[i])
                total += rendered * (1 if gain > 0 else -1 if gain < 0 else 0)
    pairs = count * (count - 1) // 2
    return RankAgreement(total / decided if decided else None, decided, pairs)
