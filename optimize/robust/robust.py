"""Robust designs: good on sensors as they are built, not only on the one that is drawn (6.2).

The objective over drawn sensors is a lower quantile of S, or its mean minus one standard deviation.
Both have exact derivatives.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from optimize.design import Array, Design
from optimize.robust.tolerance_draws import BuiltSensors
from optimize.scoring import TableScorer

Measure = Literal["quantile", "spread"]
QUANTILE = 0.1
RESAMPLES = 400


@dataclass(frozen=True, eq=False)
class RobustRating:
    """What becomes of a design on sensors as built.

    Arguments:
        nominal: S on the sensor as drawn.
        mean, deviation: of S over built sensors.
        low: lower 10 % quantile of S.
        low_interval: its 95 % bootstrap interval over the draws.
        draws: number of sensors.
    """

    nominal: float
    mean: float
    deviation: float
    low: float
    low_interval: tuple[float, float]
    draws: int

    def to_json(self) -> dict[str, object]:
        """Return plain data."""
        return {**vars(self), "low_interval": list(self.low_interval)}


def rate_robustly(scorer: TableScorer, sensors: BuiltSensors, design: Design) -> RobustRating:
    """Return the rating of ``design`` over ``sensors`` that had no part in making it."""
    scores = sensors.scores(design)
    rng = np.random.default_rng(0)
    resampled = rng.choice(scores, (RESAMPLES, len(scores)))
    lows = np.quantile(resampled, QUANTILE, axis=1)
    low, high = np.quantile(lows, [0.025, 0.975])
    return RobustRating(
        nominal=scorer.score(design.phi, design.power),
        mean=float(scores.mean()),
        deviation=float(scores.std(ddof=1)),
        low=float(np.quantile(scores, QUANTILE)),
        low_interval=(float(low), float(high)),
        draws=len(scores),
    )


class RobustScore:
    """The objective over drawn sensors; see `optimize.search.local_refinement.Objective`."""

    def __init__(self, sensors: BuiltSensors, measure: Measure) -> None:
        """Take the sensors and what is made of the scores on them."""
        self.sensors, self.measure = sensors, measure
        self._shares = _quantile_shares(sensors.draws)

    def value(self, design: Design) -> float:
        """Return the lower quantile, or the mean minus one standard deviation, in counts."""
        return self._of(self.sensors.scores(design))[0]

    def gradient(self, design: Design) -> tuple[float, Array]:
        """Return the objective and its derivatives by the directions, ``(F,)`` per rad."""
        scores, slopes = self.sensors.gradients(design)
        value, weight = self._of(scores)
        return value, weight @ slopes

    def _of(self, scores: Array) -> tuple[float, Array]:
        """Return the objective of ``scores`` ``(draw,)`` and its derivative by each of them."""
        count = len(scores)
        if self.measure == "spread":
            deviation = float(scores.std(ddof=1))
            slope = (scores - scores.mean()) / ((count - 1) * max(deviation, 1e-12))
            return float(scores.mean()) - deviation, 1.0 / count - slope
        order = np.argsort(scores, kind="stable")
        weight = np.empty(count)
        weight[order] = self._shares
        return float(weight @ scores), weight


def _quantile_shares(count: int) -> Array:
    """Return weights ``(count,)`` of ascending scores that make their lower quantile.

    Harrell and Davis (1982): the i-th order statistic weighs as much as a Beta((n + 1) p,
    (n + 1) (1 - p)) variable falls between (i - 1) / n and i / n. Unlike a single order statistic
    its derivative does not jump from one sensor to another.
    """
    from scipy.special import betainc

    edges = np.arange(count + 1) / count
    a, b = (count + 1) * QUANTILE, (count + 1) * (1 - QUANTILE)
    return np.asarray(np.diff(betainc(a, b, edges)))
