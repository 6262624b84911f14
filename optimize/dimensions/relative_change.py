"""By how much one sensor reads better than another, with the error of the models that say so."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from optimize.dimensions.answer import LightErrors, StudyEffort
from optimize.objectives import ReaderName
from optimize.readers import half_width

MODEL_SPREAD: dict[StudyEffort, float] = {"drawn": 0.1, "few": 0.03, "converged": 0.03}
"""One standard deviation of the logarithm of an error's ratio between two sensors, as an effort has
it: from the finest effort (``python -m tests.validation.dimension_spread``), that of few paths on
pads without a diffuser. Converged light is taken to err as much as it differs from few paths."""
COVERAGE = 0.95


@dataclass(frozen=True)
class RelativeChange:
    """An error over that of another sensor, minus 1: -0.12 is 12 % lower; with an interval."""

    value: float
    interval: tuple[float, float]

    @property
    def lower(self) -> bool:
        """Whether the error is certain to be lower."""
        return self.interval[1] < 0.0

    @property
    def higher(self) -> bool:
        """Whether the error is certain to be higher."""
        return self.interval[0] > 0.0

    @property
    def words(self) -> str:
        """The change as people say it.

        >>> RelativeChange(-0.12, (-0.15, -0.09)).words
        '12 % [9, 15] lower'
        >>> RelativeChange(0.051, (-0.02, 0.13)).words
        '5 % [-2, 13] higher'
        """
        sign, word = (-1.0, "lower") if self.value < 0.0 else (1.0, "higher")
        ends = sorted(100.0 * sign * end for end in self.interval)
        low, high = (f"{round(end) + 0:g}" for end in ends)
        return f"{abs(100.0 * self.value):.0f} % [{low}, {high}] {word}"

    def to_json(self) -> dict[str, object]:
        """Return plain data, fractions."""
        return {"value": self.value, "interval": list(self.interval)}


def relative_change(
    present: LightErrors,
    other: LightErrors,
    reader: ReaderName,
    effort: StudyEffort,
    comparisons: int = 1,
) -> RelativeChange:
    """Return how a reader's error changes from one sensor to another, with a 95 % interval.

    The interval adds up three errors of the logarithm of the ratio: the draws of normals and noise,
    which both share; what the ``effort`` errs by (`MODEL_SPREAD`); and all of the photon noise that
    `LightErrors.mean` takes out of either. Of several ``comparisons`` with one sensor all hold at
    once (Bonferroni), so that the best of them may be picked.

    Arguments:
        present: errors of the sensor that is compared with.
        other: likewise, of the same draws.
        reader: whose errors.
        effort: of both models.
        comparisons: sensors that are held against this one.
    """
    first, last = getattr(present, reader), getattr(other, reader)
    value = math.log(other.mean(reader) / present.mean(reader))
    confidence = 1.0 - (1.0 - COVERAGE) / comparisons
    known = half_width(np.log(last / first), np.array([MODEL_SPREAD[effort]]), confidence)
    taken = [math.log(one.measured(reader) / one.mean(reader)) for one in (present, other)]
    half = math.hypot(known, *taken)
    return RelativeChange(math.expm1(value), (math.expm1(value - half), math.expm1(value + half)))
