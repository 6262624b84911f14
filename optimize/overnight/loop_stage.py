"""The verification loop of a night, round by round from the record.

What a round renders is a decision: a run that goes on renders at once, without searching again. The
refit takes all renders so far, so only the last one is needed, when the next round is proposed.
"""

from __future__ import annotations

from dataclasses import asdict
from functools import cached_property
from typing import Any

import numpy as np

from optimize.design.design import Design
from optimize.design.limits import limits_of
from optimize.exploration.explore import PHI_NODES
from optimize.overnight.budget import (
    FIXED_ROUNDS,
    LOOP_UNTIL,
    MAX_ROUNDS,
    MIN_SAMPLES,
    MIN_SHARE,
    OVERTIME_SHARE,
    CostModel,
)
from optimize.overnight.context import RunContext, design_json, design_of
from optimize.overnight.runner import OutOfTime
from optimize.overnight.search_stage import baseline_of
from optimize.scoring.jackknife import JackknifeEstimate
from optimize.verification.proposals import Proposal
from optimize.verification.renders import distinct_directions, reference_renders
from optimize.verification.verification_loop import CONVERGED, Contender, Loop, LoopConfig, Rendered
from render.chebyshev import chebyshev_nodes
from render.geometry.layout import fiber_edges
from render.reference.transport import pad_jobs
from render.transport import TransportTable
from surrogate.model.preview_grid import draw_grid
from surrogate.runtime.checker import Checker
from surrogate.training.refit import Correction, Refitter

ROUND_SHARE = 0.3
"""Part of the loop's time that the renders of one round take."""
TIME_USED = "its share of the time is used"
ROUND_SEEDS = 4
"""Seeds of a round at most: jobs that can be rendered at once."""


class LoopOutcome:
    """What the loop found.

    Arguments:
        rounds: as they were rendered.
        contenders: of all periods, best first.
        reason: why it stopped.
    """

    def __init__(self, rounds: list[Rendered], contenders: list[Contender], reason: str) -> None:
        self.rounds, self.contenders, self.reason = rounds, contenders, reason


def run_loop(
    context: RunContext, checker: Checker, start: Design, cost: CostModel | None
) -> LoopOutcome:
    """Render rounds until the surrogate has nothing better to propose, or the time is over.

    Arguments:
        context: of the run; what earlier ones found takes part.
        checker: the surrogate.
        start: the best design on it, where the first search begins.
        cost: of renders; None for a fixed amount of work.
    """
    config = _config(context, start, cost)
    loop = Loop(
        checker.transport_table(chebyshev_nodes(PHI_NODES, 0.0, np.pi)),
        baseline_of(context),
        reference_renders(
            context.scene, None, lambda _, state: context.progress(state), runner=context.renders
        ),
        _LateRefitter(context, checker),
        fiber_edges(context.scene),
        config,
        limits_of(context.scene),
        start,
    )
    loop.contenders = _known(context)
    rounds: list[Rendered] = []
    reason = f"the {config.rounds} rounds ran out"
    took = 0.0
    for number in range(1, config.rounds + 1):
        began = context.store.spent()

        def propose(number: int = number, took: float = took) -> dict[str, Any]:
            if number > 1 and took / 2 > context.seconds_until(LOOP_UNTIL):
                return {"stop": TIME_USED}
            context.stage(f"Round {number}", f"round {number}")
            context.show(0, 1)
            if loop.runs:
                loop.refit()
            found = loop.proposals(number)
            if not found:
                return {"stop": CONVERGED}
            return {"proposals": [_proposal_json(entry) for entry in found]}

        decided = context.decide(f"round {number}", propose)
        decided = context.decided(f"round {number} given up") or decided
        if "stop" in decided:
            reason = decided["stop"]
            break
        context.stage(f"Round {number}", f"round {number}")
        late = context.deadline(LOOP_UNTIL + OVERTIME_SHARE) if rounds else None
        try:
            with context.renders.until(late):
                done = loop.render(number, [_proposal_of(entry) for entry in decided["proposals"]])
        except OutOfTime:
            reason = context.decide(f"round {number} given up", lambda: {"stop": TIME_USED})["stop"]
            break
        rounds.append(done)
        took = max(context.store.spent() - began, took)
        _tell_round(context, done)
        best = max(zip(done.measured, done.proposals, strict=True), key=lambda m: m[0].score.value)
        low, high = best[0].score.interval()
        context.keep_best("reference", best[0].score.value, (high - low) / 2, f"round {number}")
    ranking = loop.ranking()
    context.decide("contenders", lambda: [_contender_json(entry) for entry in ranking])
    return LoopOutcome(rounds, ranking, reason)


def _config(context: RunContext, start: Design, cost: CostModel | None) -> LoopConfig:
    """Return how much a round renders."""

    def choose() -> dict[str, int]:
        if context.fixed is not None:
            return {"samples": context.fixed.round, "rounds": FIXED_ROUNDS, "seeds": 1}
        assert cost is not None  # with hours it is measured
        phi, _ = distinct_directions([baseline_of(context), start])
        seeds = min(ROUND_SEEDS, -(-cost.workers // (2 * len(context.bends))))
        unit = pad_jobs(context.scene, phi, context.bends, samples=64, seeds=list(range(seeds)))
        least = MIN_SHARE * (context.until - context.began)
        seconds = max(ROUND_SHARE * context.seconds_until(LOOP_UNTIL), least)
        samples = max(MIN_SAMPLES, cost.samples(unit, 64, seconds))
        return {"samples": samples, "rounds": MAX_ROUNDS, "seeds": seeds}

    found = context.decide("rounds", choose)
    # Every period of every seed searches and renders with seeds of its own.
    return LoopConfig(seed=64 * context.seed + context.number, **found)


class _LateRefitter:
    """The refitter, made when it is needed: drawing its grid takes longer than a run may wait."""

    def __init__(self, context: RunContext, checker: Checker) -> None:
        self.context, self.checker = context, checker

    @cached_property
    def _refitter(self) -> Refitter:
        preview = self.checker.metadata.preview
        grid = draw_grid(self.context.scene, int(preview["phi_nodes"]), int(preview["bend_nodes"]))
        return Refitter(self.context.scene, grid)

    def fit(self, runs: Any) -> Correction:
        return self._refitter.fit(runs)

    def apply(self, correction: Correction, table: TransportTable) -> TransportTable:
        return self._refitter.apply(correction, table)


def _tell_round(context: RunContext, done: Rendered) -> None:
    said = context.decided(f"round {done.number} said")
    if said is not None:
        return
    context.log.note(f"Round {done.number}: {done.agreement.shown}")
    for entry, measured in zip(done.proposals, done.measured, strict=True):
        score = measured.score
        context.log.note(
            f"  {entry.role}: predicted {entry.predicted:.2f}, rendered {score.value:.2f} "
            f"± {score.se:.2f}"
        )
    context.decide(f"round {done.number} said", lambda: True)


def _known(context: RunContext) -> list[Contender]:
    """Return the contenders of the period before this one."""
    if context.number == 1:
        return []
    kept = context.store.decided(f"{context.number - 1}/contenders")
    return [
        Contender(
            entry["role"],
            design_of(entry["design"]),
            [
                JackknifeEstimate(g["value"], g["plain"], g["se"], np.array(g["pseudo"]))
                for g in entry["gains"]
            ],
        )
        for entry in kept
    ]


def _contender_json(entry: Contender) -> dict[str, Any]:
    gains = [asdict(gain) | {"pseudo": gain.pseudo.tolist()} for gain in entry.gains]
    return {"role": entry.role, "design": design_json(entry.design), "gains": gains}


def _proposal_json(entry: Proposal) -> dict[str, Any]:
    return {
        "role": entry.role,
        "design": design_json(entry.design),
        "predicted": entry.predicted,
        "spread": entry.spread,
    }


def _proposal_of(content: dict[str, Any]) -> Proposal:
    return Proposal(
        content["role"], design_of(content["design"]), content["predicted"], content["spread"]
    )
