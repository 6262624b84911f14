"""Scores of rendered designs: freed of the bias of render noise, with error bars."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from optimize.design import PARTS, Array, Rating, ScoreSettings
from optimize.scoring.jackknife import JackknifeEstimate, jackknife, jackknife_parts
from render.metric import clipped_fraction

PART_TERMS = np.array(
    [[1, 1, 1, 1, 1, 1], [1, 1, 1, 1, 0, 0], [0, 0, 0, 0, -1, 0], [0, 0, 0, 0, 0, -1]]
)
"""``(part, term)`` by which terms of the score make up its parts (`PARTS`)."""
ROUNDING = 1e-12
"""Relative difference of two scores that rounding makes."""


@dataclass(frozen=True, eq=False)
class RenderedScore:
    """One design by renders, freed of the bias of the noise.

    The jackknife is linear in the statistic, so the estimates of the parts add up as the parts do:
    score = mean - spread over sites - spread over bends, to rounding.

    Arguments:
        parts: jackknife estimates with standard errors, by part of the score (`PARTS`).
        clipped: fraction of facets that saturate.
        settings: exposure, lambda and conventions of the score.
    """

    parts: dict[str, JackknifeEstimate]
    clipped: float
    settings: ScoreSettings

    @property
    def score(self) -> JackknifeEstimate:
        """S of eq. (4.7)."""
        return self.parts["score"]

    @property
    def rating(self) -> Rating:
        """What goes into a design file: the parts, and the 95 % interval of the score."""
        values = {name: estimate.value for name, estimate in self.parts.items()}
        return self.settings.rating("reference", values, self.score.interval())


def rendered_score(settings: ScoreSettings, replicates: Array, power: Array) -> RenderedScore:
    """Jackknife every part of the score of ``replicates`` ``(R, F, B, S, K)``."""
    found = jackknife_parts(
        lambda transport: PART_TERMS * settings.terms(transport, power), replicates
    )
    parts = dict(zip(PARTS, found, strict=True))
    counts = settings.counts(replicates.mean(axis=0), power)
    return RenderedScore(parts, float(clipped_fraction(counts, settings.conventions)), settings)


def paired_difference(
    settings: ScoreSettings, first: Array, first_power: Array, second: Array, second_power: Array
) -> JackknifeEstimate:
    """Return S of the second design minus S of the first.

    Both have replicates ``(R, F, B, S, K)`` that were made together, so that noise which they
    share cancels. Designs that are alike but for names of their colors do not differ at all, and
    what sums round makes none better.
    """

    def gain(transport: Array) -> Array:
        low, high = (
            settings.terms(light, power)
            for light, power in zip(transport, (first_power, second_power), strict=True)
        )
        more = high - low
        return more if abs(more.sum()) > ROUNDING * abs(low.sum()) else np.zeros_like(more)

    return jackknife(gain, np.stack([first, second], axis=1))
