"""The stages that find and verify designs: searches, rounds of the verification loop, finalists.

Searches render nothing. What a round renders is a decision: a run that goes on renders at once,
without searching again. The refit takes all renders so far, so only the last one is needed, when
the next round is proposed. The final verification renders one batch of seeds after the other until
the time is used; their replicates are pooled.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from optimize.design import Design, ScoreSettings, dimmed_baseline, limits_of, turning_limits
from optimize.overnight.context import (
    LOOP_UNTIL,
    OVERTIME_SHARE,
    REPORT_SECONDS,
    TIME_USED,
    UNIT_SAMPLES,
    RunContext,
    design_of,
    samples_within,
)
from optimize.scoring import JackknifeEstimate, TableScorer, search_table
from optimize.search import alternating_search, search_by_reader
from optimize.ui.console import counted
from optimize.verification import (
    CONVERGED,
    Candidate,
    DesignRenders,
    FinalistEvaluation,
    Judge,
    LoopConfig,
    Proposal,
    RenderedRound,
    SceneRefit,
    VerificationLoop,
    allocation_of,
    distinct_directions,
    judge_of,
    pooled_renders,
    reference_renders,
    score_allocation,
    thesis_on_table,
)
from render.geometry import fiber_edges
from render.progress import Progress
from render.reference import RenderCost, SampleAllocation, transport_jobs
from render.transport import TransportTable
from surrogate.runtime import Checker


def night_judge(context: RunContext, checker: Checker) -> Judge:
    """Return what decides between designs, on the scale of the night's model."""
    settings = ScoreSettings(checker.exposure, checker.lam)
    return judge_of(context.objective, context.scene, settings, checker)


def search_designs(context: RunContext, checker: Checker) -> tuple[dict[str, Design], Design]:
    """Return designs on the way to the best one on the model, by their keys, and the best.

    On the way are the best colors at the baseline's directions, or the best design by S where a
    reader decides.
    """

    def search() -> dict[str, Any]:
        context.stage("Colors and directions on the surrogate", "search")
        scorer = TableScorer(search_table(checker), limits=limits_of(context.scene))
        found = alternating_search(
            scorer,
            dimmed_baseline(context.scene),
            edges=fiber_edges(context.scene),
            seed=context.seed,
        )
        if context.objective == "score":
            return {"before": {"colors": found.colored}, "best": found.design,
                    "value": found.score}  # fmt: skip
        goal = night_judge(context, checker).on_table(scorer)
        starts = [found.history[0].design, found.design]
        read = search_by_reader(scorer, goal, starts, seed=context.seed)
        return {"before": {"score": found.design}, "best": read.design, "value": -read.score}

    kept = context.decide("search", search)
    value, half = kept["value"], checker.score_half_width
    interval = (value - half, value + half) if context.objective == "score" else None
    context.keep_best(value, interval, "found on the surrogate", checker)
    before = {key: design_of(design) for key, design in kept["before"].items()}
    return before, design_of(kept["best"])


def thesis_design(
    context: RunContext, table: Callable[[], TransportTable], checker: Checker
) -> Design | None:
    """Return what the thesis's procedure (4.3) makes of the reference table.

    None where the scene has constraints, which that procedure does not know.
    """
    if context.scene.constraints is not None:
        return None

    def search() -> Design:
        context.stage("Thesis-style design on the table", "thesis")
        exposed = replace(table(), exposure=checker.exposure, lam=checker.lam)
        baseline = dimmed_baseline(context.scene)
        limits = turning_limits(context.scene)
        scorer = TableScorer(exposed.at_bends(context.bends), limits=limits)
        return thesis_on_table(scorer, baseline, fiber_edges(context.scene), context.seed)

    return design_of(context.decide("thesis", search))


ROUND_SHARE = 0.3
"""Part of the loop's time that the renders of one round take."""
MAX_ROUNDS, MAX_ROUND_SEEDS = 12, 4
"""Rounds of a period, and seeds of a round: jobs that can be rendered at once."""


class LoopOutcome(NamedTuple):
    """What the loop found: rounds as rendered, candidates of all periods (best first), its end."""

    rounds: list[RenderedRound]
    candidates: list[Candidate]
    reason: str


def run_loop(context: RunContext, checker: Checker, start: Design) -> LoopOutcome:
    """Render rounds until the surrogate has nothing better to propose, or the time is over.

    What earlier periods found takes part. The first search begins at ``start``, the best design on
    the surrogate.
    """
    baseline = dimmed_baseline(context.scene)
    amount = context.amount("rounds", lambda cost: _affordable_rounds(context, cost, start))
    judge = night_judge(context, checker)
    loop = VerificationLoop(
        judge,
        search_table(checker),
        baseline,
        reference_renders(context.scene, None, context.progress, runner=context.renders),
        SceneRefit(context.scene, checker),
        # Every period of every seed searches and renders with seeds of its own.
        LoopConfig(seed=64 * context.seed + context.number, **amount),
        limits_of(context.scene),
        start,
    )
    if context.number > 1:
        known = context.store.decided(f"{context.number - 1}/contenders")
        loop.candidates = [_candidate_of(entry) for entry in known]
    rounds: list[RenderedRound] = []

    def propose(number: int, longest: float) -> dict[str, Any]:
        if number > amount["rounds"]:
            return {"stop": f"{counted(amount['rounds'], 'round')} did not settle it"}
        if number > 1 and longest / 2 > context.seconds_until(LOOP_UNTIL):
            return {"stop": TIME_USED}
        context.stage(f"Round {number}", f"round {number}")
        context.progress(Progress(0, 1))
        if loop.runs:
            loop.refit()
        found = loop.proposals(number)
        if not found:
            return {"stop": CONVERGED}
        return {"proposals": found, "allocation": loop.allocation(found)}

    def render(number: int, decided: dict[str, Any]) -> None:
        context.stage(f"Round {number}", f"round {number}")
        proposals = [
            Proposal(**entry | {"design": design_of(entry["design"])})
            for entry in decided["proposals"]
        ]
        done = loop.render(number, proposals, allocation_of(decided.get("allocation")))
        rounds.append(done)
        context.log.note(f"Round {number}: {done.agreement.shown}")
        for entry, measured, converged in zip(proposals, done.values, done.converged, strict=True):
            context.log.note(
                f"  {entry.role}: predicted {judge.told(entry.score)}, rendered "
                f"{judge.told(measured.value)} ± {measured.se:.2f}"
                f"{'' if converged else ', not converged'}"
            )
        best = max(done.values, key=lambda measured: measured.value)
        _keep_rendered(context, judge, best, f"round {number}")

    reason = context.steps("round", propose, render, context.deadline(LOOP_UNTIL + OVERTIME_SHARE))
    context.decide("contenders", lambda: loop.candidates)
    return LoopOutcome(rounds, loop.ranking(), reason)


def _keep_rendered(context: RunContext, judge: Judge, best: JackknifeEstimate, what: str) -> None:
    """Keep what renders say of the best design so far."""
    low, high = sorted(judge.sign * end for end in best.interval())
    context.keep_best(judge.sign * best.value, (low, high), what)


def _affordable_rounds(context: RunContext, cost: RenderCost, start: Design) -> dict[str, int]:
    phi, _ = distinct_directions([dimmed_baseline(context.scene), start])
    seeds = min(MAX_ROUND_SEEDS, -(-cost.workers // (2 * len(context.bends))))
    unit = transport_jobs(
        context.scene, phi, context.bends, samples=UNIT_SAMPLES, seeds=list(range(seeds))
    )
    seconds = max(ROUND_SHARE * context.seconds_until(LOOP_UNTIL), context.least_seconds)
    samples = samples_within(cost, unit, seconds)
    return {"samples": samples, "rounds": MAX_ROUNDS, "seeds": seeds}


def _candidate_of(content: dict[str, Any]) -> Candidate:
    """Return the candidate that the decision of an earlier period holds."""
    gains = [JackknifeEstimate(**g | {"pseudo": np.array(g["pseudo"])}) for g in content["gains"]]
    return Candidate(content["role"], design_of(content["design"]), gains)


FINAL_PURPOSE = 3
MIN_BATCHES = 3


def choose_finalists(
    context: RunContext,
    before: dict[str, Design],
    thesis: Design | None,
    loop_outcome: LoopOutcome,
) -> dict[str, Design]:
    """Return who is verified, by key, the baseline first."""

    def choose() -> dict[str, Design]:
        finalists = {"baseline": dimmed_baseline(context.scene), **before}
        if thesis is not None:
            finalists["thesis"] = thesis
        best = [entry.design for entry in loop_outcome.candidates[:2]]
        return finalists | dict(zip(("winner", "runner-up"), best, strict=False))

    kept = context.decide("finalists", choose)
    return {key: design_of(design) for key, design in kept.items()}


def verify_finalists(
    context: RunContext, finalists: dict[str, Design], checker: Checker
) -> FinalistEvaluation:
    """Return the evaluation of the finalists by batches of seeds, until the time is used.

    The finalists were chosen before the first of these seeds, so those of extensions are pooled.
    """
    names, designs = tuple(finalists), list(finalists.values())
    judge = night_judge(context, checker)

    def allocate() -> SampleAllocation:
        leader = names.index("winner") if "winner" in names else 0
        table = search_table(checker)
        return score_allocation(
            context.scene, table, judge.settings, designs, leader=leader, untouched=True
        )

    allocation = allocation_of(context.decide("final allocation", allocate))
    amount = context.amount("final", lambda cost: _affordable_batch(context, cost, designs))
    render = reference_renders(context.scene, None, context.progress, runner=context.renders)
    parts: list[DesignRenders] = []

    def plan(number: int, longest: float) -> dict[str, Any]:
        if number > amount.get("batches", number):
            return {"stop": "all batches are rendered"}
        # The last batch may end as much too late as it would end too early without it.
        if number > 1 and longest / 2 > context.seconds_until(1.0) - REPORT_SECONDS:
            return {"stop": TIME_USED}
        first = (number - 1) * amount["seeds"]
        return {
            "seeds": [context.random_seed(FINAL_PURPOSE, first + i) for i in range(amount["seeds"])]
        }

    def work(_number: int, decided: dict[str, Any]) -> None:
        context.stage("Final verification", "final")
        seeds, samples = decided["seeds"], amount["samples"]
        parts.append(
            render(
                designs,
                samples=samples,
                seeds=seeds,
                title="the finalists",
                allocation=allocation,
            )
        )

    late = context.until - REPORT_SECONDS / 2
    for extension in range(context.extension + 1):
        name = f"final batch, extension {extension}" if extension else "final batch"
        context.steps(name, plan, work, late, first=len(parts) + 1)
    evaluation = FinalistEvaluation(names, pooled_renders(parts, amount["seeds"]), judge)
    best = evaluation.best("winner")
    _keep_rendered(context, judge, evaluation.value(best), best)
    return evaluation


def _affordable_batch(
    context: RunContext, cost: RenderCost, designs: Sequence[Design]
) -> dict[str, int]:
    """Return samples per cell and seed, and the seeds of a batch."""
    phi, _ = distinct_directions(designs)
    jobs = len(context.bends)
    seeds = -(-2 * cost.workers // jobs) if cost.workers > jobs else 1
    unit = transport_jobs(
        context.scene,
        phi,
        context.bends,
        samples=UNIT_SAMPLES,
        seeds=list(range(seeds)),
    )
    free = (context.seconds_until(1.0) - REPORT_SECONDS) / MIN_BATCHES
    seconds = max(context.least_seconds, min(2 * cost.fixed * jobs, free))
    return {"samples": samples_within(cost, unit, seconds), "seeds": seeds}
