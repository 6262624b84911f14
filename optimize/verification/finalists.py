"""Finalists: rendered anew, until it is known which of them is best.

Whoever wins a noisy contest was lucky as well as good. So finalists are rendered once more with
seeds that had no part in choosing them, and the figures that are reported come from these renders.
They go on, batch by batch, until the verdict is significant, cannot become so any more, or their
time is used. Looking again and again finds something by chance, so every look has a share of the
error rate alpha = 5 %: that of the time that it took, alpha t in all after the fraction t (alpha
spending, Lan and DeMets 1983; power family with rho = 1, Kim and DeMets 1987). Shares add up to
alpha at most, so the intervals of the last look hold whenever renders end (union bound).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from optimize.design import Design, Rating, ReadErrors, ScoreSettings
from optimize.objectives import READERS, ReaderName
from optimize.readers import (
    CameraModel,
    ExposedColors,
    saturating_tilts,
)
from optimize.scoring import JackknifeEstimate, RenderedScore, student_factor
from optimize.verification.design_renders import DesignRenders, RenderDesigns, pooled_renders
from optimize.verification.judges import Judge, Judged
from render.reference import EVERYTHING, SampleAllocation

FINALISTS = "the finalists"
"""Title of their renders."""
PLURAL = ("colors",)
"""Names of finalists that stand for several things."""
ALPHA = 0.05
"""Rate at which intervals may fail, all looks together."""


@dataclass(frozen=True, eq=False)
class FinalistEvaluation:
    """Fresh figures of the finalists and their paired differences.

    Arguments:
        names: of the finalists, in the order of everything else.
        renders: what the figures come from, with the untouched pad.
        judge: says which of them is best.
        confidence: of this look's intervals, which are 95 % intervals for all looks together.
    """

    names: tuple[str, ...]
    renders: DesignRenders
    judge: Judge
    confidence: float = 0.95

    @property
    def settings(self) -> ScoreSettings:
        """Of the scores."""
        return self.judge.settings

    @cached_property
    def scores(self) -> tuple[RenderedScore, ...]:
        """Scores of the finalists."""
        return tuple(self.renders.score(self.settings, i) for i in range(len(self.names)))

    @cached_property
    def judged(self) -> Judged:
        """The finalists under the judge."""
        return self.judge.judged(self.renders)

    def score(self, name: str) -> RenderedScore:
        """Return the finalist's score."""
        return self.scores[self.names.index(name)]

    def error(self, name: str, reader: ReaderName) -> JackknifeEstimate:
        """Return by how many degrees ``reader`` misses normals of the finalist."""
        return self.judged.degrees(reader).errors[self.names.index(name)]

    def rating(self, name: str) -> Rating:
        """Return what goes into the finalist's file: its score, and what readers make of it.

        Where noise takes an estimated error below 0, the file says 0.
        """
        colors = self.renders.colors(self.settings).mean(axis=0)[self.names.index(name)]
        exposed = ExposedColors.of(colors, CameraModel.of(self.judge.scene))
        sensor, place = (max(self.error(name, reader).value, 0.0) for reader in READERS)
        saturates = saturating_tilts(self.judge.scene, exposed.colors)
        read = ReadErrors(sensor, place, exposed.factor, exposed.gain, saturates)
        return replace(self.score(name).rating, read=read)

    def value(self, name: str) -> JackknifeEstimate:
        """Return the judge's figure of the finalist; more is better."""
        return self.judged.value(self.names.index(name))

    def gain(self, first: str, second: str) -> JackknifeEstimate:
        """Return the judge's figure of the second finalist minus that of the first, paired."""
        return self.judged.difference(self.names.index(first), self.names.index(second))

    def difference(self, first: str, second: str) -> JackknifeEstimate:
        """Return S of the second finalist minus S of the first, paired."""
        i, j = self.names.index(first), self.names.index(second)
        return self.renders.difference(self.settings, i, j)

    def error_difference(self, first: str, second: str, reader: ReaderName) -> JackknifeEstimate:
        """Return by how many degrees more ``reader`` misses normals of the second finalist."""
        return self.judged.degrees(reader).difference(
            self.names.index(first), self.names.index(second)
        )

    def interval(self, first: str, second: str) -> tuple[float, float]:
        """Return the 95 % interval of the gain of the second finalist over the first."""
        return self.gain(first, second).interval(self.confidence)

    def best(self, leader: str) -> str:
        """Return ``leader``, unless renders show that another is better by more than error bars.

        Those that have not converged show nothing.
        """
        for name in self.names:
            better = name != leader and self.interval(leader, name)[0] > 0
            if better and not (self.doubt(leader) or self.doubt(name)):
                leader = name
        return leader

    def settled(self, leader: str, used: float) -> bool:
        """Return whether more renders are of no use.

        All have converged, and the best is better than every other one by more than the error
        bars, or a tie with it stays one: even if the difference is a standard error larger, the
        interval would hold 0 when all of the time is used, of which ``used`` is the fraction so
        far.
        """
        if any(self.doubt(name) for name in self.names):
            return False
        best, count = self.best(leader), len(self.renders.replicates)
        factor = student_factor(round(count / used)) * np.sqrt(used)
        for name in self.names:
            low, high = self.interval(name, best) if name != best else (1.0, 1.0)
            gain = self.gain(name, best)
            if low <= 0.0 <= high and abs(gain.value) + gain.se > factor * gain.se:
                return False
        return True

    def doubt(self, name: str) -> str:
        """Say why the finalist's score has not converged; "" where it has."""
        return self._doubts[self.names.index(name)]

    @cached_property
    def _doubts(self) -> tuple[str, ...]:
        return tuple(self.renders.doubt(self.settings, i) for i in range(len(self.names)))

    def comparison(self, first: str, second: str) -> str:
        """Say which of two finalists is better, or that the renders cannot tell."""
        for name in (second, first):
            if said := self.doubt(name):
                return f"The renders of the {name} have not converged: {said}."
        ends = self.interval(first, second)
        low, high = ends if self.judge.sign > 0 else reversed(ends)
        interval = (
            f"95% interval of the difference {self.judge.told(low, '+')} to "
            f"{self.judge.told(high, '+')}"
        )
        if ends[0] > 0 or ends[1] < 0:
            better, worse = (second, first) if ends[0] > 0 else (first, second)
            verb = "are" if better in PLURAL else "is"
            return f"The {better} {verb} better {self.judge.by} than the {worse} ({interval})."
        return f"The {second} and the {first} tie {self.judge.by} ({interval})."


def evaluate_finalists(
    render: RenderDesigns,
    judge: Judge,
    finalists: Sequence[tuple[str, Design]],
    *,
    samples: int,
    seeds: Sequence[int],
    leader: str = "",
    seconds: float = 0.0,
    allocation: SampleAllocation = EVERYTHING,
) -> FinalistEvaluation:
    """Render the ``finalists`` together until the verdict is settled, and judge them.

    Arguments:
        render: renders designs together.
        judge: of the finalists.
        finalists: names and designs.
        samples: per cell and seed.
        seeds: of the first batch, fresh ones; those of the next ones follow.
        leader: whose differences matter, unless another turns out to be better.
        seconds: of rendering at most; the first batch is always rendered.
        allocation: where the samples go, in all batches alike.
    """
    names, designs = tuple(name for name, _ in finalists), [design for _, design in finalists]
    parts: list[DesignRenders] = []
    before = 0.0
    while True:
        batch = [seed + len(parts) * len(seeds) for seed in seeds]
        parts.append(
            render(designs, samples=samples, seeds=batch, title=FINALISTS, allocation=allocation)
        )
        renders = pooled_renders(parts, len(seeds))
        last = renders.seconds + max(part.seconds for part in parts) > seconds
        used = 1.0 if last else renders.seconds / seconds
        level = 1.0 - ALPHA * (used - before)
        evaluation = FinalistEvaluation(names, renders, judge, level)
        if last or evaluation.settled(leader, used):
            return evaluation
        before = used
