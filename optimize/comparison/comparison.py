"""Several designs side by side: degrees, scores, and what tells each pair apart.

Readers see all designs with common normals and noise, and the sensor reader decides. Degrees are
compared across sensors, S only within one, whose exposure it is counted at. On a model the
intervals of differences in degrees are those of the draws, and of what its colors may be off by.

On a model every score has the same interval, ± h. The errors of two designs are not independent:
one model made both, and designs that are alike share most of their errors. For two random designs
the interval of the difference is ± sqrt(2) h, as for independent errors; for designs that are alike
it is too wide. A design that a search chose on the model is not random: it was chosen for the
model's errors too, and only renders tell. Renders of one sensor with common seeds are paired: noise
that two designs share cancels in their difference (see `optimize.verification`). Those of two
sensors are independent.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from optimize.comparison.named_designs import NamedDesign
from optimize.design import Design
from optimize.exploration import Stage, rate
from optimize.objectives import READERS, ReaderName
from optimize.readers import JSON_NAMES, compare_readings
from optimize.report import (
    clipping_warning,
    doubted_gain,
    guessing_warning,
    holder_warning,
    preview_warnings,
)
from optimize.scoring import search_table
from optimize.verification import (
    FinalistEvaluation,
    RenderDesigns,
    judge_of,
    score_allocation,
)
from render.scene import Scene
from surrogate.runtime import Checker, RankingTest

LETTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZ"
CONFIDENCE = 0.95
"""Of intervals from renders."""


Interval = tuple[float, float]


@dataclass(frozen=True)
class DesignDifference:
    """What the second design has more than the first, with intervals.

    Arguments:
        first, second: places of the designs in the comparison.
        errors: difference and interval of what each reader misses, in degrees.
        score: difference and interval of S, in counts; None between two sensors.
        doubt: why it decides nothing whatever its intervals; "" usually.
        score_doubt: why S decides nothing, likewise.
        recolored: number of lamps with another color; None between two sensors.
        turned: mean angle in degrees between the directions of a lamp, likewise.
    """

    first: int
    second: int
    errors: Mapping[ReaderName, tuple[float, Interval]]
    score: tuple[float, Interval] | None = None
    doubt: str = ""
    score_doubt: str = ""
    recolored: int | None = None
    turned: float | None = None

    @property
    def better(self) -> int | None:
        """The place of the design that the sensor reader reads better; None where none is."""
        low, high = self.errors["sensor"][1]
        return self._decided((-high, -low), self.doubt)

    @property
    def better_in_score(self) -> int | None:
        """The place of the design that is better in S; None where none is."""
        return None if self.score is None else self._decided(self.score[1], self.score_doubt)

    def _decided(self, interval: Interval, doubt: str) -> int | None:
        """Return who gains; None where the interval of the gain holds 0 or there is a doubt."""
        low, high = interval
        if doubt or low <= 0.0 <= high:
            return None
        return self.second if low > 0.0 else self.first


@dataclass(frozen=True, eq=False)
class DesignComparison:
    """Designs at one level of the ladder.

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
    def best(self) -> Stage:
        """The design that the sensor reader misses least."""
        return min(self.stages, key=lambda stage: stage.reader_error)

    @property
    def decided(self) -> bool:
        """Whether renders show that the best design is better than every other one."""
        best = self.stages.index(self.best)
        of_best = [one for one in self.differences if best in (one.first, one.second)]
        return self.samples is not None and all(one.better == best for one in of_best)

    @property
    def scenes(self) -> tuple[Scene, ...]:
        """The sensors of the designs, each once."""
        return tuple({stage.scene.hash: stage.scene for stage in self.stages}.values())

    def verdict(self, difference: DesignDifference) -> str:
        """Say which design of a pair is read better, and which one is better in S."""
        read = "undecided" if difference.doubt else "both read alike"
        if difference.better is not None:
            read = f"{self.stages[difference.better].key} reads better"
        if difference.score is None:
            return read
        scored = "undecided" if difference.score_doubt else "tie"
        if difference.better_in_score is not None:
            scored = f"{self.stages[difference.better_in_score].key} is better"
        return f"{read}, {scored} in S"

    def pair(self, difference: DesignDifference) -> str:
        """Name a difference, ``B - A``."""
        return f"{self.stages[difference.second].key} - {self.stages[difference.first].key}"


def compare_on_model(
    designs: Sequence[NamedDesign], models: Mapping[str, Checker]
) -> DesignComparison:
    """Rate ``designs`` on the models of their scenes, by hash, and compare every pair."""
    stages = tuple(
        rate(models[one.scene.hash], one.scene, letter, f"{letter} {one.name}", "", one.design)
        for letter, one in zip(LETTERS, designs, strict=False)
    )
    rankings = {key: RankingTest.of(model.metadata) for key, model in models.items()}

    def difference(first: int, second: int) -> DesignDifference:
        low, high = stages[first], stages[second]
        read = compare_readings(low.reading, high.reading)
        found = {reader: read[f"{JSON_NAMES[reader]}_mean"] for reader in READERS}
        errors = {reader: (one.difference, one.interval) for reader, one in found.items()}
        both = [rankings[stage.scene.hash] for stage in (low, high)]
        doubt = next((ranking.advice() for ranking in both if not ranking.reliable), "")
        if low.scene.hash != high.scene.hash:
            return DesignDifference(first, second, errors, doubt=doubt)
        value = high.rating.score - low.rating.score
        half = math.sqrt(2.0) * models[low.scene.hash].score_half_width
        reach = 0.0 if _same(low.design, high.design) else half
        return _in_one_scene(
            DesignDifference(
                first,
                second,
                errors,
                (value, (value - reach, value + reach)),
                doubt,
                doubted_gain((high if value > 0 else low).design, both[0]),
            ),
            stages,
        )

    warnings: list[str] = []
    for scene in {stage.scene.hash: stage.scene for stage in stages}.values():
        ranking, model = rankings[scene.hash], models[scene.hash]
        warnings += [] if ranking.reliable else [ranking.advice()]
        warnings += preview_warnings(scene, model.level, model.photon_noise)
    halves = [math.sqrt(2.0) * model.score_half_width for model in models.values()]
    coverage = min(model.coverage for model in models.values())
    reach = f"± {max(halves):.2f}" if len(halves) == 1 else f"at most ± {max(halves):.2f}"
    (level, *_) = {model.level for model in models.values()}
    return DesignComparison(
        stages,
        tuple(difference(*pair) for pair in combinations(range(len(stages)), 2)),
        coverage,
        "Intervals of readers' differences are of draws of normals and noise, and of what the "
        f"{level}'s colors may be off by. Those of S, {reach}, cover those of {coverage:.0%} of "
        f"pairs of random designs. One {level} made all scores of a sensor: designs that are alike "
        "share its errors, and their difference is known better than this; a design that a search "
        "found was chosen for its errors too, so renders decide (--samples 200).",
        tuple(dict.fromkeys(warnings + _warnings(stages))),
    )


def compare_by_renders(
    rated: DesignComparison,
    render_of: Callable[[Scene], RenderDesigns],
    models: Mapping[str, Checker],
    *,
    samples: int,
    seeds: Sequence[int],
) -> DesignComparison:
    """Render the designs of ``rated``, those of a sensor together, and compare every pair.

    Arguments:
        rated: the same designs on their models, whose scales stay.
        render_of: returns what renders designs of a scene with common light paths.
        models: by the hash of their scene; they help to read noisy renders.
        samples: per cell and seed.
        seeds: common to all designs.
    """
    finalists: dict[str, FinalistEvaluation] = {}
    stages, unconverged = list(rated.stages), [""] * len(rated.stages)
    for scene in rated.scenes:
        places = [i for i, stage in enumerate(stages) if stage.scene.hash == scene.hash]
        own, model = [stages[place] for place in places], models[scene.hash]
        settings = own[0].settings
        designs = [stage.design for stage in own]
        renders = render_of(scene)(
            designs,
            samples=samples,
            seeds=seeds,
            title="designs",
            allocation=score_allocation(
                scene, search_table(model), settings, designs, untouched=True
            ),
        )
        judge = judge_of("sensor", scene, settings, model)
        names = tuple(stage.key for stage in own)
        found = finalists[scene.hash] = FinalistEvaluation(names, renders, judge, CONFIDENCE)
        for index, (place, stage) in enumerate(zip(places, own, strict=True)):
            stages[place] = _rendered(stage, index, found)
            unconverged[place] = renders.doubt(settings, index, samples)

    def difference(first: int, second: int) -> DesignDifference:
        low, high = stages[first], stages[second]
        doubt = unconverged[first] or unconverged[second]
        one, other = finalists[low.scene.hash], finalists[high.scene.hash]
        if one is not other:
            gains = {
                reader: other.error(high.key, reader) - one.error(low.key, reader)
                for reader in READERS
            }
        else:
            gains = {reader: one.error_difference(low.key, high.key, reader) for reader in READERS}
        errors = {reader: (gain.value, gain.interval(CONFIDENCE)) for reader, gain in gains.items()}
        if one is not other:
            return DesignDifference(first, second, errors, doubt=doubt)
        gain = one.difference(low.key, high.key)
        score_doubt = doubt or doubted_gain((high if gain.value > 0 else low).design, None)
        scored = gain.value, gain.interval(CONFIDENCE)
        return _in_one_scene(
            DesignDifference(first, second, errors, scored, doubt, score_doubt), stages
        )

    doubts = [
        f"The renders of {stage.key} have not converged: {doubt}."
        for stage, doubt in zip(stages, unconverged, strict=True)
        if doubt
    ]
    return DesignComparison(
        tuple(stages),
        tuple(difference(*pair) for pair in combinations(range(len(stages)), 2)),
        CONFIDENCE,
        "Differences of one sensor's designs are paired: they were rendered with the same light "
        f"paths, whose noise cancels in part. {CONFIDENCE:.0%} intervals cover the noise of the "
        "renders, one pair at a time; errors of the scene file are not in them.",
        tuple(doubts + _warnings(stages)),
        samples,
    )


def _rendered(stage: Stage, index: int, found: FinalistEvaluation) -> Stage:
    """Return a stage as the renders have it, the design ``index`` of them."""
    light = found.renders.replicates[:, index].mean(axis=0)
    scored = found.score(stage.key)
    return replace(
        stage,
        rating=scored.rating,
        clipped=scored.clipped,
        metric=stage.settings.metric(light, stage.design.power),
        counts=stage.settings.counts(light, stage.design.power),
        photon_noise=None,
        rendered={reader: found.error(stage.key, reader) for reader in READERS},
    )


def _in_one_scene(one: DesignDifference, stages: Sequence[Stage]) -> DesignDifference:
    """Return a difference of one sensor's designs with what was changed between them."""
    low, high = (stages[place].design for place in (one.first, one.second))
    return replace(
        one,
        recolored=int(np.count_nonzero(low.colors != high.colors)),
        turned=float(np.degrees(np.abs(low.phi - high.phi)).mean()),
    )


def _same(first: Design, second: Design) -> bool:
    return np.array_equal(first.phi, second.phi) and np.array_equal(first.power, second.power)


def _warnings(stages: Sequence[Stage]) -> list[str]:
    texts = []
    for stage in stages:
        own = guessing_warning(stage.scene, stage.reader_error)
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
