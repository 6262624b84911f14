"""The verification loop: the surrogate proposes, renders decide, the surrogate is refitted.

Each round renders the surrogate's best design, the most uncertain of the next-best ones and a
random one, together with the baseline, the surrogate's first optimum and its best challengers so
far. All of them are directions of one run, so their differences share its noise. The surrogate is
then refitted to the new renders, where they bear that out. The loop goes on while the surrogate
ranks the designs badly (Kendall's tau below 0.85) or proposes something better than what was
rendered.

The loop never makes it worse: the first optimum leads until renders show that a challenger is
better by more than their error bars (successive elimination, Even-Dar et al. 2006: challengers
that are shown to be worse are rendered no more).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Protocol

import numpy as np

from optimize.design import Array, Design, SearchLimits
from optimize.scoring import (
    JackknifeEstimate,
    RankAgreement,
    TableScorer,
    pooled_estimate,
    rank_agreement,
)
from optimize.ui.console import counted
from optimize.verification.design_proposals import Proposal, proposal_of, propose, same_design
from optimize.verification.design_renders import DesignRenders, RenderDesigns
from optimize.verification.finalists import ALPHA
from optimize.verification.judges import Judge
from optimize.verification.score_allocation import score_allocation
from render.chebyshev import interpolation_weights
from render.errors import TableError
from render.reference import SampleAllocation
from render.scene import Scene
from render.transport import TransportTable
from surrogate.runtime import Checker

if TYPE_CHECKING:  # torch comes with the refit
    from surrogate.training.refit import NewRenders, Refitter, ResidualCorrection

MIN_TAU = 0.85
MIN_RELATIVE_GAIN = 1e-3
"""Predicted gain, as a fraction of the score, below which a proposal needs no further round."""
SEED_STRIDE = 1000
"""Between the render seeds of different seeds of the loop."""
SEED_STEP = 50
"""Between the render seeds of one round."""
CONVERGED = "the surrogate proposes nothing better than what was rendered"
FIRST = "first"
"""Role of the surrogate's first optimum."""
FAR_BEHIND = ("baseline", "random")
"""Roles of designs that are not expected to be among the best."""
CHALLENGERS = 2
"""Challengers that are rendered again in a round."""


@dataclass(frozen=True)
class LoopConfig:
    """How much is rendered.

    Arguments:
        samples: per cell and seed in every round.
        rounds: at most; seed: of searches and renders.
        seeds: independent renders per round, which can be made at once.
        seconds: of rendering in all rounds; the first is always rendered.
    """

    samples: int = 96
    rounds: int = 4
    seed: int = 0
    seeds: int = 1
    seconds: float = math.inf


@dataclass(frozen=True, eq=False)
class RenderedRound:
    """A round before its refit: what was proposed, and what the renders said.

    Arguments:
        proposals: what was rendered, the baseline and the surrogate's first optimum first;
            predictions are those before the refit.
        values: the judge's figures of them; more is better.
        converged: whether noise leaves them a figure; where not, error bars are too short.
        gains: figure minus the baseline's, paired.
        agreement: of predicted and rendered ranking.
        seconds: of rendering.
        interval: 95 % interval of the figure of design j minus that of design i.
    """

    number: int
    proposals: tuple[Proposal, ...]
    values: tuple[JackknifeEstimate, ...]
    converged: tuple[bool, ...]
    gains: tuple[JackknifeEstimate, ...]
    agreement: RankAgreement
    seconds: float
    interval: Callable[[int, int], tuple[float, float]]


@dataclass(frozen=True, eq=False)
class LoopRound(RenderedRound):
    """A whole round, with what the refit made of it.

    Arguments:
        refitted: agreement of the ranking after the refit.
        correction: what the refit found in all rounds so far.
    """

    refitted: RankAgreement
    correction: ResidualCorrection


class SurrogateRefit(Protocol):
    """Fits corrections of the surrogate and applies them, see `surrogate.training.refit`."""

    def fit(self, runs: Sequence[NewRenders]) -> ResidualCorrection:
        """Return the correction by all ``runs``."""

    def apply(self, correction: ResidualCorrection, table: TransportTable) -> TransportTable:
        """Return ``table`` with the correction."""


class SceneRefit:
    """A `SurrogateRefit` of a scene's model, made when it is needed: its grid takes seconds."""

    def __init__(self, scene: Scene, checker: Checker) -> None:
        self._scene, self._preview = scene, checker.metadata.preview

    @cached_property
    def _refitter(self) -> Refitter:
        from surrogate.model.preview_grid import draw_grid
        from surrogate.training.refit import Refitter

        phi, bends = int(self._preview["phi_nodes"]), int(self._preview["bend_nodes"])
        return Refitter(self._scene, draw_grid(self._scene, phi, bends))

    def fit(self, runs: Sequence[NewRenders]) -> ResidualCorrection:
        """Return the correction by all ``runs``."""
        return self._refitter.fit(runs)

    def apply(self, correction: ResidualCorrection, table: TransportTable) -> TransportTable:
        """Return ``table`` with the correction."""
        return self._refitter.apply(correction, table)


@dataclass
class Candidate:
    """A rendered design with its gains over the surrogate's first optimum, one a round."""

    role: str
    design: Design
    gains: list[JackknifeEstimate] = field(default_factory=list)

    @property
    def gain(self) -> JackknifeEstimate:
        """The gain by all rounds: rounds of equal effort count alike.

        Weights by the error bars of single rounds would favor those that came out small by chance.
        """
        return pooled_estimate(self.gains)


@dataclass(frozen=True, eq=False)
class LoopResult:
    """The outcome: candidates, best first, rounds, seconds of rendering and why it stopped."""

    candidates: tuple[Candidate, ...]
    rounds: tuple[LoopRound, ...]
    seconds: float
    reason: str


class VerificationLoop:
    """What the rounds share: candidates, renders and the surrogate as it stands.

    ``round`` is ``render`` and then ``refit``; a round that is only read from a record needs no
    refit of its own, because a refit takes all renders so far.

    Arguments of the constructor:
        judge: says what is better, of designs of which sensor.
        table: the surrogate's, with background.
        baseline: the design to beat; it is rendered in every round.
        render: renders designs together.
        refitter: of the surrogate.
        config: how much is rendered.
        limits: of what is proposed.
        start: searches begin there while the surrogate rates it above the best candidate.
    """

    def __init__(
        self,
        judge: Judge,
        table: TransportTable,
        baseline: Design,
        render: RenderDesigns,
        refitter: SurrogateRefit,
        config: LoopConfig,
        limits: SearchLimits | None = None,
        start: Design | None = None,
    ) -> None:
        """Begin without candidates."""
        self.judge = judge
        self.original = self.table = table
        self.baseline, self.renderer, self.refitter = baseline, render, refitter
        self.config, self.limits, self.start = config, limits, start
        self.candidates: list[Candidate] = []
        self.runs: list[NewRenders] = []
        self.agreement: RankAgreement | None = None
        self.misfit = 0.0

    def run(self, report: Callable[[LoopRound], None] | None = None) -> LoopResult:
        """Return the designs that renders found best; ``report`` is called after every round."""
        rounds: list[LoopRound] = []
        reason = f"{counted(self.config.rounds, 'round')} did not settle it"
        for number in range(1, self.config.rounds + 1):
            proposals = self.proposals(number)
            if not proposals:
                reason = CONVERGED
                break
            rounds.append(self.round(number, proposals))
            if report is not None:
                report(rounds[-1])
            spent = sum(entry.seconds for entry in rounds)
            if spent + max(entry.seconds for entry in rounds) > self.config.seconds:
                reason = "its part of the render seconds is used"
                break
        seconds = sum(entry.seconds for entry in rounds)
        return LoopResult(tuple(self.ranking()), tuple(rounds), seconds, reason)

    def ranking(self) -> list[Candidate]:
        """Return the candidates that may be the best: the leader, then by rendered gain.

        The leader is the first optimum until the interval of a challenger's gain over it lies above
        0, and it stays the second then; a challenger whose interval lies below 0 is out. Intervals
        hold for all challengers and rounds together (Bonferroni).
        """
        if not self.candidates:
            return []
        first, *rest = self.candidates
        level = 1.0 - ALPHA / (self.config.rounds * max(len(rest), 1))
        rest = [entry for entry in rest if entry.gain.interval(level)[1] > 0.0]
        rest.sort(key=lambda entry: -entry.gain.value)
        if rest and rest[0].gain.interval(level)[0] > 0.0:
            return [rest[0], first, *rest[1:]]
        return [first, *rest]

    def proposals(self, number: int) -> list[Proposal]:
        """Return what round ``number`` renders; nothing when it has converged.

        The baseline, then the surrogate's first optimum, then its best challengers so far
        (``incumbent``), then what is new.
        """
        scorer = TableScorer(self.table, limits=self.limits)
        goal = self.judge.on_table(scorer)
        leaders = [entry.design for entry in self.ranking()[: CHALLENGERS + 1]]
        starts = [*leaders, *([] if self.start is None else [self.start])] or [self.baseline]
        best = max(starts, key=goal.value)
        known = [entry.design for entry in self.candidates]
        seed = SEED_STRIDE * self.config.seed + number
        proposed = propose(scorer, best, self.judge, seed=seed, known=known)
        if self.agreement is not None:
            tau, leader = self.agreement.tau, goal.value(leaders[0])
            highest = max((p.score for p in proposed if p.role == "best"), default=leader)
            converged = highest - leader < MIN_RELATIVE_GAIN * abs(leader)
            if not proposed or (converged and tau is not None and tau >= MIN_TAU):
                return []
        if not known:
            proposed[0] = replace(proposed[0], role=FIRST)
        again = [("baseline", self.baseline), *((FIRST, design) for design in known[:1])]
        again += [("incumbent", design) for design in leaders if design is not known[0]]
        return [*(proposal_of(scorer, self.judge, *entry) for entry in again), *proposed]

    def allocation(self, proposals: Sequence[Proposal]) -> SampleAllocation:
        """Return where the samples of a round go: to the first optimum and its challengers.

        That the baseline and the random design are worse takes few of them. The table is the
        surrogate's as it was shipped, which no render has changed.
        """
        rivals = [i for i, entry in enumerate(proposals) if entry.role not in FAR_BEHIND]
        designs = [entry.design for entry in proposals]
        return score_allocation(
            self.judge.scene,
            self.original,
            self.judge.settings,
            designs,
            leader=1,
            rivals=rivals,
            untouched=True,
        )

    def render(
        self, number: int, proposals: Sequence[Proposal], allocation: SampleAllocation
    ) -> RenderedRound:
        """Render and measure what ``proposals`` returned, with the samples of ``allocation``."""
        first = SEED_STRIDE * (self.config.seed + 1) + number
        renders = self.renderer(
            [entry.design for entry in proposals],
            samples=self.config.samples,
            seeds=[first + SEED_STEP * i for i in range(self.config.seeds)],
            title=f"round {number}",
            allocation=allocation,
        )
        judged = self.judge.judged(renders)
        values = [judged.value(i) for i in range(len(proposals))]
        gains = [judged.difference(0, i) for i in range(1, len(proposals))]
        for index, proposal in enumerate(proposals[1:], start=1):
            candidate = self._candidate(proposal)
            if index > 1:
                candidate.gains.append(judged.difference(1, index))
                self.misfit += self._misfit(proposals[1], proposal, candidate.gains[-1])

        def interval(i: int, j: int) -> tuple[float, float]:
            return judged.difference(i, j).interval()

        predicted = np.array([entry.score for entry in proposals])
        self.agreement = rank_agreement(predicted, interval)
        self.runs.append(self._observed(renders))
        return RenderedRound(
            number,
            tuple(proposals),
            tuple(values),
            tuple(not renders.doubt(self.judge.settings, i) for i in range(len(proposals))),
            tuple(gains),
            self.agreement,
            renders.seconds,
            interval,
        )

    def refit(self) -> ResidualCorrection:
        """Correct the surrogate by all renders so far, unless they bear no correction out.

        The refit is the judge of those that it has seen. Of those that it had not, predictions
        must have been no worse than the surrogate's own: a chi-square of gains over the first
        optimum, paired, over all rounds.
        """
        correction = self.refitter.fit(self.runs)
        if self.misfit > 0.0:
            correction = replace(correction, tau=0.0)
        self.table = self.refitter.apply(correction, self.original)
        return correction

    def round(self, number: int, proposals: Sequence[Proposal]) -> LoopRound:
        """Render, measure and refit."""
        rendered = self.render(number, proposals, self.allocation(proposals))
        correction = self.refit()
        goal = self.judge.on_table(TableScorer(self.table, limits=self.limits))
        after = goal.values([entry.design for entry in proposals])
        refitted = rank_agreement(after, rendered.interval)
        return LoopRound(**vars(rendered), refitted=refitted, correction=correction)

    def _misfit(self, first: Proposal, other: Proposal, gain: JackknifeEstimate) -> float:
        """Return chi-square of the gain that was predicted, minus that without a refit."""
        original = self.judge.on_table(TableScorer(self.original))
        without = original.values([first.design, other.design])
        errors = np.array([other.score - first.score, without[1] - without[0]]) - gain.value
        squares = (errors / max(gain.se, 1e-12)) ** 2
        return float(squares[0] - squares[1])

    def _candidate(self, proposal: Proposal) -> Candidate:
        for entry in self.candidates:
            if same_design(entry.design, proposal.design):
                return entry
        self.candidates.append(Candidate(proposal.role, proposal.design))
        return self.candidates[-1]

    def _observed(self, renders: DesignRenders) -> NewRenders:
        """Return the renders beside the prediction of the surrogate as it was shipped."""
        from surrogate.training.refit import NewRenders

        phi = np.stack([design.phi for design in renders.designs])
        return NewRenders(
            phi=phi,
            bends=self.original.bends,
            replicates=renders.with_pad,
            predicted=np.stack([_predicted(self.original, row) for row in phi]),
        )


def _predicted(table: TransportTable, phi: Array) -> Array:
    """Return the table's transport ``(F, B, S, facet + 1[, C])``, the untouched pad last."""
    if table.background is None:
        raise TableError("the surrogate's table has no background", field="background")
    weights = interpolation_weights(table.phi, phi)
    pad = np.einsum("fj,fjbs...->fbs...", weights, table.background)
    return np.concatenate([table.at(phi), np.expand_dims(pad, 3)], axis=3)
