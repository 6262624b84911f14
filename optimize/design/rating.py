"""How good a design is: its score, at which level of the ladder, under which settings."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from optimize.design.design import Array, Design
from optimize.design.limits import dimmed_baseline
from render.levels import Effort, Level, level_name
from render.metric import THESIS, MetricConfig, design_score, image_counts, score_terms, site_metric
from render.scene import Scene

CLIPPED = 0.01
"""A design with a larger fraction of saturated facets gets a warning."""
PARTS = ("score", "mean", "spread_sites", "spread_bends")
"""S of eq. (4.7) and what it is made of."""


def noise_words(photon_noise: float | None) -> str:
    """Return what follows the name of a level whose photons leave noise; else nothing.

    >>> noise_words(0.0123)
    ', photon noise 1.2% of the color'
    """
    return "" if photon_noise is None else f", photon noise {photon_noise:.1%} of the color"


def design_digest(scene_hash: str, design: Design) -> str:
    """Return 12 hex digits of a design and its scene."""
    content = scene_hash.encode() + design.phi.tobytes() + design.drive.tobytes()
    return hashlib.sha256(content).hexdigest()[:12]


@dataclass(frozen=True)
class ScoreSettings:
    """What turns transport into a score: the camera and the weights, fixed once per scene.

    Arguments:
        exposure: counts per unit of radiance.
        lam: weight of M_phi in eq. (4.6).
        conventions: of the metric.
    """

    exposure: float
    lam: float
    conventions: MetricConfig = THESIS

    def counts(self, transport: Array, power: Array) -> Array:
        """Return counts ``(B, S, K, C)``: ``transport`` ``(F, B, S, K[, C])``, ``power`` (F, C)."""
        return np.asarray(image_counts(transport, power, self.exposure, self.conventions))

    def metric(self, transport: Array, power: Array) -> Array:
        """Return M of eq. (4.6), ``(B, S)``."""
        counts = self.counts(transport, power)
        return np.asarray(site_metric(counts, self.lam, self.conventions))

    def parts(self, transport: Array, power: Array) -> Array:
        """Return score, mean, spread over sites and over bends, ``(4,)`` (eq. 4.7)."""
        score = design_score(self.metric(transport, power), self.conventions)
        return np.array([float(getattr(score, part)) for part in PARTS])

    def terms(self, transport: Array, power: Array) -> Array:
        """Return the six terms that the score is the sum of (`render.metric.score_terms`)."""
        return score_terms(self.counts(transport, power), self.lam, self.conventions)

    def rating(
        self,
        level: Level,
        parts: Mapping[str, float],
        interval: tuple[float, float],
        effort: Effort | None = None,
    ) -> Rating:
        """Return the rating with the values of ``parts`` and the ``interval`` of the score."""
        score, mean, sites, bends = (parts[name] for name in PARTS)
        return Rating(level, score, interval, mean, sites, bends, self, effort)


@dataclass(frozen=True)
class ReadErrors:
    """By how many degrees readers miss normals, and the exposure at which they do.

    Arguments:
        reader_error_deg: of the *sensor* reader, one smooth map for the whole sensor.
        normal_error_deg: of the *place* reader, a lookup that knows every place.
        exposure_factor: how much brighter than at the scene's exposure the colors are.
        gain: of the camera; the exposure time is ``exposure_factor / gain`` times the scene's.
        saturates_deg: tilt from which on each channel saturates somewhere; None where it never
            does, () where nobody has asked.
    """

    reader_error_deg: float
    normal_error_deg: float
    exposure_factor: float
    gain: float
    saturates_deg: tuple[float | None, ...] = ()


@dataclass(frozen=True)
class Rating:
    """The score of a design and its parts, in counts.

    ``interval`` is that of ``score``: 90 % on the surrogate, 95 % from renders. ``read`` is what
    readers make of the design, None where none was asked.
    """

    level: Level
    score: float
    interval: tuple[float, float]
    mean: float
    spread_sites: float
    spread_bends: float
    settings: ScoreSettings
    effort: Effort | None = None
    read: ReadErrors | None = None

    @property
    def level_name(self) -> str:
        """Level and effort as people read them."""
        return level_name(self.level, self.effort)


@dataclass(frozen=True, eq=False)
class RatedDesign:
    """A design with its rating, for the scene that it was made for."""

    scene: Scene
    design: Design
    rating: Rating

    @property
    def settings(self) -> ScoreSettings:
        """The camera and the weights that it was rated with."""
        return self.rating.settings

    @property
    def digest(self) -> str:
        """12 hex digits of the design and its scene."""
        return design_digest(self.scene.hash, self.design)

    @property
    def baseline(self) -> Design:
        """The design to beat, with no LED above what the scene allows."""
        return dimmed_baseline(self.scene)
