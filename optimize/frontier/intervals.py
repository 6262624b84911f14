"""Whether the model's intervals hold an independent reference of designs that it never saw."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from optimize.frontier.designs import HeldOut
from optimize.frontier.reference import Reference
from optimize.scoring.intervals import student_factor
from render.scene.schema import Scene
from surrogate.runtime.checker import Checker


@dataclass(frozen=True)
class Held:
    """Parts of lit channels of facets and of scores that lie within their intervals."""

    nominal: float
    counts: float
    score: float


def held_by_intervals(
    scene: Scene, checker: Checker, designs: HeldOut, reference: Reference
) -> Held:
    """Return how often the intervals of ``checker`` hold ``reference``.

    They are meant for the reference without its noise. Its own interval of the same coverage, by
    Student's t over its replicates, is added in quadrature: two normal errors would then be held
    exactly as often as promised.
    """
    found = checker.run(designs.phi, designs.power, np.array(scene.bending.angles))
    noise = student_factor(reference.replicates, checker.coverage)
    spread = found["counts_spread"].astype(np.float64)
    lit = spread > 0
    off = np.abs(found["counts"] - reference.counts)[lit]
    reach = np.hypot(checker.counts_reach * spread, noise * reference.counts_se)[lit]
    score_off = np.abs(found["score"] - reference.scores)
    score_reach = np.hypot(checker.score_reach, noise * reference.scores_se)
    return Held(
        nominal=checker.coverage,
        counts=float(np.mean(off <= reach)),
        score=float(np.mean(score_off <= score_reach)),
    )
