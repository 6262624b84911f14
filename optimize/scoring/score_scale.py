"""What turns transport into a score: exposure, lambda and conventions, fixed once per scene."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from optimize.design.design import Array, Level, Rating
from render.metric import THESIS, MetricConfig, design_score, image_counts, site_metric

PARTS = ("score", "mean", "spread_sites", "spread_bends")


@dataclass(frozen=True)
class Scale:
    """The camera and the weights of the score.

    Arguments:
        exposure: counts per unit of radiance.
        lam: weight of M_phi in eq. (4.6).
        conventions: of the metric.
    """

    exposure: float
    lam: float
    conventions: MetricConfig = THESIS

    def counts(self, transport: Array, power: Array) -> Array:
        """Return counts ``(B, S, K, 3)`` of ``transport`` ``(F, B, S, K)``, ``power`` (F, 3)."""
        return np.asarray(image_counts(transport, power, self.exposure, self.conventions))

    def parts(self, transport: Array, power: Array) -> Array:
        """Return score, mean, spread over sites and over bends, ``(4,)`` (eq. 4.7)."""
        metric = site_metric(self.counts(transport, power), self.lam, self.conventions)
        score = design_score(metric, self.conventions)
        return np.array([float(getattr(score, part)) for part in PARTS])

    def rating(
        self, level: Level, parts: dict[str, float], interval: tuple[float, float]
    ) -> Rating:
        """Return the rating with the values of ``parts`` and the 95 % ``interval`` of the score."""
        return Rating(
            level=level,
            score=parts["score"],
            interval=interval,
            mean=parts["mean"],
            spread_sites=parts["spread_sites"],
            spread_bends=parts["spread_bends"],
            lam=self.lam,
            exposure=self.exposure,
            conventions=self.conventions,
        )
