"""Several designs of one scene side by side: scores, and what tells each pair apart.

On a model every score has the same interval, ± h. The errors of two designs are not independent:
one model made both, and designs that are alike share most of their errors. For two random designs
the interval of the difference is ± sqrt(2) h, as for independent errors; for designs that are alike
it is too wide. A design that a search chose on the model is not random: it was chosen for the
model's errors too, and only renders tell. Renders with common seeds are paired: noise that two
designs share cancels in their difference (see `optimize.verification`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from optimize.comparison.named_designs import NamedDesign
from optimize.design import Design
from optimize.exploration import Stage, rate
from optimize.report import (
    clipping_warning,
    doubted_gain,
    guessing_warning,
    holder_warning,
    preview_warnings,
    reader_verdict,
)
from optimize.verification import FinalistEvaluation, RenderDesigns
from render.reference import PRESSED, SampleAllocation
from render.scene import Scene
from surrogate.runtime import Checker, RankingTest

LETTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZ"
CONFIDENCE = 0.95
"""Of intervals from renders."""


@dataclass(frozen=True)
class DesignDifference:
    """S of the second design minus S of the first, in counts, with its interval.

    Arguments:
        first, second: places of the designs in the comparison.
        value, interval: of the difference.
        doubt: why it decides nothing whatever its interval; "" usually.
        recolored: number of fibers with another color.
        turned: mean angle in degrees between the directions of a fiber.
    """

    first: int
    second: int
    value: float
    interval: tuple[float, float]
    doubt: str
    recolored: int
    turned: float

    @property
    def better(self) -> int | None:
        """The place of the better design; None where the interval holds 0 or there is a doubt."""
        low, high = self.interval
        if self.doubt or low <= 0.0 <= high:
            return None
        return self.second if low > 0.0 else self.first


@dataclass(frozen=True, eq=False)
class DesignComparison:
    """Designs of one scene at one level of the ladder.

    Arguments:
        stages: the designs as they are rated, in the order given; their keys are letters.
        differences: of every pair.
        coverage: how often the intervals hold the true value, on the conditions in ``covers``.
        covers: what the interval of a difference covers, one sentence.
        warnings: what makes designs or scores doubtful.
        samples: of the renders, per cell and seed; None on a model.
    """

    stages: tuple[Stage, ...]
    differences: tuple[DesignDifference, ...]
    coverage: float
    covers: str
    warnings: tuple[str, ...]
    samples: int | None = None

    @property
    def decided(self) -> bool:
        """Whether renders show that the best design is better than every other one."""
        best = max(range(len(self.stages)), key=lambda i: self.stages[i].rating.score)
        of_best = [one for one in self.differences if best in (one.first, one.second)]
        return self.samples is not None and all(one.better == best for one in of_best)

    @property
    def scene(self) -> Scene:
        """The sensor of all designs."""
        return self.stages[0].scene

    @property
    def level(self) -> str:
        """Who computed the scores."""
        return self.stages[0].rating.level

    def verdict(self, difference: DesignDifference) -> str:
        """Say which design of a pair is better in S, and which one is read better."""
        pair = [self.stages[place] for place in (difference.first, difference.second)]
        (one, two), (low, high) = (stage.key for stage in pair), (s.normal_error for s in pair)
        read = reader_verdict((one, two), (low, high))
        if difference.better is not None:
            return f"{self.stages[difference.better].key} is better in S, {read}"
        return f"{'undecided' if difference.doubt else 'tie'} in S, {read}"

    def pair(self, difference: DesignDifference) -> str:
        """Name a difference, ``B - A``."""
        return f"{self.stages[difference.second].key} - {self.stages[difference.first].key}"


def compare_on_model(
    checker: Checker, scene: Scene, designs: Sequence[NamedDesign]
) -> DesignComparison:
    """Rate ``designs`` on the model of their scene, and compare every pair."""
    stages = tuple(
        rate(checker, scene, letter, f"{letter} {entry.name}", "", entry.design)
        for letter, entry in zip(LETTERS, designs, strict=False)
    )
    half = math.sqrt(2.0) * checker.score_half_width
    ranking = RankingTest.of(checker.metadata)

    def difference(first: int, second: int) -> tuple[float, tuple[float, float], str]:
        low, high = stages[first], stages[second]
        value = high.rating.score - low.rating.score
        reach = 0.0 if _same(low.design, high.design) else half
        better = high if value > 0 else low
        return value, (value - reach, value + reach), doubted_gain(better.design, ranking)

    warnings = [] if ranking.reliable else [ranking.advice()]
    warnings += preview_warnings(scene, checker.level, checker.photon_noise)
    return DesignComparison(
        stages,
        _pairs(stages, difference),
        checker.coverage,
        f"Intervals of differences, ± {half:.2f}, cover those of {checker.coverage:.0%} of pairs "
        f"of random designs. One {checker.level} made all scores: designs that are alike share "
        "its errors, and their difference is known better than this; a design that a search found "
        "was chosen for its errors too, so renders decide (--samples 200).",
        tuple(warnings + _warnings(stages)),
    )


def compare_by_renders(
    rated: DesignComparison,
    render: RenderDesigns,
    *,
    samples: int,
    seeds: Sequence[int],
    allocation: SampleAllocation = PRESSED,
) -> DesignComparison:
    """Render the designs of ``rated`` together, and compare every pair.

    Arguments:
        rated: the same designs on the model, whose scale and normal errors stay.
        render: renders designs with common light paths.
        samples: per cell and seed.
        seeds: common to all designs.
        allocation: where the samples go.
    """
    settings = rated.stages[0].settings
    renders = render(
        [stage.design for stage in rated.stages],
        samples=samples,
        seeds=seeds,
        title="designs",
        allocation=allocation,
    )
    names = tuple(stage.key for stage in rated.stages)
    finalists = FinalistEvaluation(names, renders, settings, CONFIDENCE)
    stages = []
    for index, stage in enumerate(rated.stages):
        light = renders.replicates[:, index].mean(axis=0)
        scored = finalists.score(stage.key)
        stages.append(
            replace(
                stage,
                rating=scored.rating,
                clipped=scored.clipped,
                metric=settings.metric(light, stage.design.power),
                counts=settings.counts(light, stage.design.power),
                photon_noise=None,
            )
        )
    unconverged = [renders.doubt(settings, index, samples) for index in range(len(stages))]

    def difference(first: int, second: int) -> tuple[float, tuple[float, float], str]:
        gain = finalists.difference(names[first], names[second])
        doubt = unconverged[first] or unconverged[second]
        doubt = doubt or doubted_gain(stages[second if gain.value > 0 else first].design, None)
        return gain.value, gain.interval(CONFIDENCE), doubt

    doubts = [
        f"The renders of {name} have not converged: {doubt}."
        for name, doubt in zip(names, unconverged, strict=True)
        if doubt
    ]
    return DesignComparison(
        tuple(stages),
        _pairs(stages, difference),
        CONFIDENCE,
        "Differences are paired: all designs were rendered with the same light paths, whose noise "
        f"cancels in part. Their {CONFIDENCE:.0%} intervals cover the noise of the renders, one "
        "pair at a time; errors of the scene file are not in them.",
        tuple(doubts + _warnings(stages)),
        samples,
    )


def _pairs(
    stages: Sequence[Stage],
    difference: Callable[[int, int], tuple[float, tuple[float, float], str]],
) -> tuple[DesignDifference, ...]:
    found = []
    for first, second in combinations(range(len(stages)), 2):
        low, high = stages[first].design, stages[second].design
        value, interval, doubt = difference(first, second)
        found.append(
            DesignDifference(
                first,
                second,
                value,
                interval,
                doubt,
                recolored=int(np.count_nonzero(low.colors != high.colors)),
                turned=float(np.degrees(np.abs(low.phi - high.phi)).mean()),
            )
        )
    return tuple(found)


def _same(first: Design, second: Design) -> bool:
    return np.array_equal(first.phi, second.phi) and np.array_equal(first.power, second.power)


def _warnings(stages: Sequence[Stage]) -> list[str]:
    texts = []
    for stage in stages:
        own = guessing_warning(stage.scene, stage.normal_error)
        own += holder_warning(stage.scene, stage.design) + clipping_warning(stage.clipped)
        if stage.design.monochrome:
            own.append("One color lights everything, which tells no azimuth.")
        if stage.domain_excess > 0:
            own.append(
                f"Beyond what the model was trained on (excess {stage.domain_excess:.2g}), its "
                "score is an extrapolation."
            )
        texts += [f"{stage.key}: {text}" for text in own]
    return texts
