"""The stages that find and verify designs: searches, rounds of the verification loop, finalists.

Searches render nothing. What a round renders is a decision: a run that goes on renders at once,
without searching again. The refit takes all renders so far, so only the last one is needed, when
the next round is proposed. The final verification renders one batch of seeds after the other until
the time is used; their replicates are pooled.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from optimize.design import Array, Design, ScoreSettings, dimmed_baseline, limits_of
from optimize.overnight.context import (
    FIXED_ROUNDS,
    FIXED_SEEDS,
    LOOP_UNTIL,
    MAX_ROUNDS,
    MIN_SHARE,
    OVERTIME_SHARE,
    REPORT_SECONDS,
    RunContext,
    design_json,
    design_of,
    extended,
    samples_within,
)
from optimize.scoring import JackknifeEstimate, TableScorer, search_table
from optimize.search import (
    SearchStep,
    alternating_search,
    optimize_directions,
    population,
    tied_groups,
)
from optimize.search.colors import grouped_colors, renamed_like
from optimize.ui.console import counted
from optimize.verification import (
    CONVERGED,
    GENERATIONS,
    Candidate,
    DesignRenders,
    FinalistEvaluation,
    LoopConfig,
    Proposal,
    RenderedRound,
    VerificationLoop,
    distinct_directions,
    reference_renders,
)
from render.chebyshev import interpolation_weights
from render.geometry import fiber_edges
from render.progress import Progress
from render.reference import RenderCost, transport_jobs
from render.transport import TransportTable
from surrogate.model.preview_grid import draw_grid
from surrogate.runtime import Checker
from surrogate.training.refit import Refitter, ResidualCorrection


def baseline_of(context: RunContext) -> Design:
    """Return the design to beat."""
    return dimmed_baseline(context.scene)


def search_designs(context: RunContext, checker: Checker) -> tuple[Design, Design]:
    """Return the best colors at the baseline's directions, and the best design, on the model."""

    def search() -> dict[str, Any]:
        context.stage("Colors and directions on the surrogate", "search")
        table = search_table(checker)
        steps: list[SearchStep] = []

        def report(step: SearchStep) -> None:
            steps.append(step)
            context.progress(Progress(len(steps), len(steps) + 1))

        found = alternating_search(
            TableScorer(table, limits=limits_of(context.scene)),
            baseline_of(context),
            edges=fiber_edges(context.scene),
            seed=context.seed,
            progress=report,
        )
        colored = next(step for step in found.history if step.stage == "quick")
        return {
            "colors": design_json(colored.design),
            "best": design_json(found.design),
            "scores": [colored.score, found.score],
            "monochrome": found.design.monochrome,
        }

    kept = context.decide("search", search)
    context.keep_best(
        "surrogate", kept["scores"][1], checker.score_half_width, "found on the surrogate"
    )
    return design_of(kept["colors"]), design_of(kept["best"])


def thesis_design(
    context: RunContext, table: Callable[[], TransportTable], checker: Checker
) -> Design | None:
    """Return what the thesis's procedure (4.3) makes of the reference table.

    Colors in pairs at the baseline's directions, then directions tied by side and color, by
    CMA-ES. None where the scene has constraints, which that procedure does not know.
    """
    if context.scene.constraints is not None:
        return None

    def search() -> dict[str, Any]:
        context.stage("Thesis-style design on the table", "thesis")
        rendered = table()
        at_bends = interpolation_weights(rendered.bends, context.bends)
        own = replace(
            rendered,
            T=np.einsum("ab,fjbsk->fjask", at_bends, rendered.T),
            se=np.einsum("ab,fjbsk->fjask", at_bends, rendered.se),
            bends=context.bends,
            background=None,
            background_se=None,
            exposure=checker.exposure,
            lam=checker.lam,
        )
        scorer, baseline = TableScorer(own), baseline_of(context)
        found = grouped_colors(scorer, baseline.phi)
        colors = renamed_like(found.colors, baseline.colors)
        colored = Design.of_colors(baseline.phi, colors)
        groups = tied_groups(fiber_edges(context.scene), colors)
        turned = optimize_directions(
            lambda phi: scorer.direction_scores(phi, colored.power),
            baseline.phi,
            groups=groups,
            bounds=scorer.phi_bounds,
            seed=context.seed,
            max_evaluations=1 + GENERATIONS * population(int(groups.max()) + 1),
        )
        return design_json(Design(turned.phi, colored.power)) | {"believed": turned.score}

    return design_of(context.decide("thesis", search))


ROUND_SHARE = 0.3
"""Part of the loop's time that the renders of one round take."""
TIME_USED = "its share of the time is used"
ROUND_SEEDS = 4
"""Seeds of a round at most: jobs that can be rendered at once."""


@dataclass(frozen=True)
class LoopOutcome:
    """What the loop found.

    Arguments:
        rounds: as they were rendered.
        candidates: of all periods, best first.
        reason: why it stopped.
    """

    rounds: list[RenderedRound]
    candidates: list[Candidate]
    reason: str


def run_loop(
    context: RunContext, checker: Checker, start: Design, cost: RenderCost | None
) -> LoopOutcome:
    """Render rounds until the surrogate has nothing better to propose, or the time is over.

    Arguments:
        context: of the run; what earlier ones found takes part.
        checker: the surrogate.
        start: the best design on it, where the first search begins.
        cost: of renders; None for a fixed amount of work.
    """
    config = _config(context, start, cost)
    loop = VerificationLoop(
        search_table(checker),
        baseline_of(context),
        reference_renders(context.scene, None, context.progress, runner=context.renders),
        _LateRefitter(context, checker),
        fiber_edges(context.scene),
        config,
        limits_of(context.scene),
        start,
    )
    loop.candidates = _known(context)
    rounds: list[RenderedRound] = []
    reason = f"{counted(config.rounds, 'round')} did not settle it"
    took = 0.0
    for number in range(1, config.rounds + 1):
        began = context.store.spent()

        def propose(number: int = number, took: float = took) -> dict[str, Any]:
            if number > 1 and took / 2 > context.seconds_until(LOOP_UNTIL):
                return {"stop": TIME_USED}
            context.stage(f"Round {number}", f"round {number}")
            context.progress(Progress(0, 1))
            if loop.runs:
                loop.refit()
            found = loop.proposals(number)
            if not found:
                return {"stop": CONVERGED}
            return {"proposals": [_proposal_json(entry) for entry in found]}

        decided = context.decide(f"round {number}", propose)
        if "stop" in decided:
            reason = decided["stop"]
            break
        context.stage(f"Round {number}", f"round {number}")
        late = context.deadline(LOOP_UNTIL + OVERTIME_SHARE) if rounds else None
        proposals = [_proposal_of(entry) for entry in decided["proposals"]]
        render = partial(loop.render, number, proposals)
        done = context.within(f"round {number}", late, render, {"stop": TIME_USED})
        if done is None:
            reason = TIME_USED
            break
        rounds.append(done)
        took = max(context.store.spent() - began, took)
        _log_round(context, done)
        best = max(zip(done.scores, done.proposals, strict=True), key=lambda m: m[0].score.value)
        low, high = best[0].score.interval()
        context.keep_best("reference", best[0].score.value, (high - low) / 2, f"round {number}")
    ranking = loop.ranking()
    context.decide("contenders", lambda: [_candidate_json(entry) for entry in ranking])
    return LoopOutcome(rounds, ranking, reason)


def _config(context: RunContext, start: Design, cost: RenderCost | None) -> LoopConfig:
    """Return how much a round renders."""

    def choose() -> dict[str, int]:
        if context.fixed is not None:
            return {"samples": context.fixed.round, "rounds": FIXED_ROUNDS, "seeds": 1}
        assert cost is not None  # with hours it is measured
        phi, _ = distinct_directions([baseline_of(context), start])
        seeds = min(ROUND_SEEDS, -(-cost.workers // (2 * len(context.bends))))
        unit = transport_jobs(
            context.scene, phi, context.bends, samples=64, seeds=list(range(seeds))
        )
        least = MIN_SHARE * (context.until - context.began)
        seconds = max(ROUND_SHARE * context.seconds_until(LOOP_UNTIL), least)
        samples = samples_within(cost, unit, 64, seconds)
        return {"samples": samples, "rounds": MAX_ROUNDS, "seeds": seeds}

    amount = context.decide("rounds", choose)
    # Every period of every seed searches and renders with seeds of its own.
    return LoopConfig(seed=64 * context.seed + context.number, **amount)


class _LateRefitter:
    """The refitter, made when it is needed: drawing its grid takes longer than a run may wait."""

    def __init__(self, context: RunContext, checker: Checker) -> None:
        self.context, self.checker = context, checker

    @cached_property
    def _refitter(self) -> Refitter:
        preview = self.checker.metadata.preview
        grid = draw_grid(self.context.scene, int(preview["phi_nodes"]), int(preview["bend_nodes"]))
        return Refitter(self.context.scene, grid)

    def fit(self, runs: Any) -> ResidualCorrection:
        return self._refitter.fit(runs)

    def apply(self, correction: ResidualCorrection, table: TransportTable) -> TransportTable:
        return self._refitter.apply(correction, table)


def _log_round(context: RunContext, done: RenderedRound) -> None:
    said = context.decided(f"round {done.number} said")
    if said is not None:
        return
    context.log.note(f"Round {done.number}: {done.agreement.shown}")
    for entry, measured in zip(done.proposals, done.scores, strict=True):
        score = measured.score
        context.log.note(
            f"  {entry.role}: predicted {entry.score:.2f}, rendered {score.value:.2f} "
            f"± {score.se:.2f}"
        )
    context.decide(f"round {done.number} said", lambda: True)


def _known(context: RunContext) -> list[Candidate]:
    """Return the candidates of the period before this one."""
    if context.number == 1:
        return []
    kept = context.store.decided(f"{context.number - 1}/contenders")
    return [
        Candidate(
            entry["role"],
            design_of(entry["design"]),
            [
                JackknifeEstimate(g["value"], g["plain"], g["se"], np.array(g["pseudo"]))
                for g in entry["gains"]
            ],
        )
        for entry in kept
    ]


def _candidate_json(entry: Candidate) -> dict[str, Any]:
    gains = [asdict(gain) | {"pseudo": gain.pseudo.tolist()} for gain in entry.gains]
    return {"role": entry.role, "design": design_json(entry.design), "gains": gains}


def _proposal_json(entry: Proposal) -> dict[str, Any]:
    return {
        "role": entry.role,
        "design": design_json(entry.design),
        "predicted": entry.score,
        "spread": entry.spread,
    }


def _proposal_of(content: dict[str, Any]) -> Proposal:
    return Proposal(
        design_of(content["design"]), content["predicted"], content["role"], content["spread"]
    )


FINAL_PURPOSE = 3
MIN_BATCHES = 3
MANY_SEEDS = 16
"""From so many seeds on, the mean of each is one replicate."""
TITLES = {
    "baseline": "Baseline",
    "colors": "Colors",
    "thesis": "Thesis-style design",
    "winner": "Winner",
    "runner-up": "Runner-up",
}


def choose_finalists(
    context: RunContext, colored: Design, thesis: Design | None, loop_outcome: LoopOutcome
) -> list[tuple[str, Design]]:
    """Return who is verified, by key."""

    def choose() -> list[dict[str, Any]]:
        finalists = [("baseline", baseline_of(context)), ("colors", colored)]
        finalists += [("thesis", thesis)] if thesis is not None else []
        best = [entry.design for entry in loop_outcome.candidates[:2]]
        finalists += list(zip(("winner", "runner-up"), best, strict=False))
        return [{"key": key, "design": design_json(design)} for key, design in finalists]

    kept = context.decide("finalists", choose)
    return [(entry["key"], design_of(entry["design"])) for entry in kept]


def verify_finalists(
    context: RunContext,
    finalists: Sequence[tuple[str, Design]],
    settings: ScoreSettings,
    cost: RenderCost | None,
) -> tuple[FinalistEvaluation, list[tuple[int, FinalistEvaluation]]]:
    """Return the evaluation of all seeds, and those of the first 1, 2, 4, ... seeds.

    The finalists were chosen before the first of these seeds, so those of extensions are pooled.

    Arguments:
        context: of the run.
        finalists: designs by key, the baseline first.
        settings: of the scores.
        cost: of renders; None for a fixed amount of work.
    """
    designs = [design for _, design in finalists]
    amount = _amount(context, designs, cost)
    render = reference_renders(context.scene, None, context.progress, runner=context.renders)
    pooled = _Pool(finalists, settings)
    checks: list[tuple[int, FinalistEvaluation]] = []
    longest, number, extension = 0.0, 0, 0
    while True:
        began = context.store.spent()
        name = extended(f"final batch {number + 1}", extension)

        def another(number: int = number, longest: float = longest) -> list[int]:
            if context.fixed is not None and number == FIXED_SEEDS:
                return []
            # The last batch may end as much too late as it would end too early without it.
            if number and longest / 2 > context.seconds_left - REPORT_SECONDS:
                return []
            first = number * amount["seeds"]
            return [context.random_seed(FINAL_PURPOSE, first + i) for i in range(amount["seeds"])]

        seeds = context.decide(name, another)
        renders = None
        if seeds:
            context.stage("Final verification", "final")
            work = partial(
                render, designs, samples=amount["samples"], seeds=seeds, title="the finalists"
            )
            late = context.until - REPORT_SECONDS / 2 if number and not context.fixed else None
            renders = context.within(name, late, work)
        if renders is None:
            if extension == context.extension:
                break
            extension += 1
            continue
        pooled.add(renders, len(seeds))
        number += 1
        longest = max(longest, context.store.spent() - began)
        if number & (number - 1) == 0:
            checks.append((number, pooled.evaluation()))
            _rate(context, checks[-1][1])
    if checks[-1][0] != number:
        checks.append((number, pooled.evaluation()))
    _rate(context, checks[-1][1])
    return checks[-1][1], checks


class _Pool:
    """Renders of the finalists, seed by seed, and what they say together."""

    def __init__(self, finalists: Sequence[tuple[str, Design]], settings: ScoreSettings) -> None:
        self.names = tuple(name for name, _ in finalists)
        self.designs = tuple(design for _, design in finalists)
        self.settings = settings
        self.pressed: list[Array] = []
        self.untouched: list[Array] = []
        self.seconds = 0.0

    def add(self, renders: DesignRenders, seeds: int) -> None:
        """Take in the renders of one batch; replicates lie seed by seed."""
        self.pressed += np.split(renders.replicates, seeds)
        self.untouched += np.split(renders.background, seeds)
        self.seconds += renders.seconds

    def evaluation(self) -> FinalistEvaluation:
        """Return scores and differences by all renders so far."""
        pressed, untouched = self.pressed, self.untouched
        if len(pressed) >= MANY_SEEDS:
            pressed, untouched = (
                [one.mean(axis=0, keepdims=True) for one in parts] for parts in (pressed, untouched)
            )
        renders = DesignRenders(
            self.designs, np.concatenate(pressed), np.concatenate(untouched), self.seconds
        )
        return FinalistEvaluation(self.names, renders, self.settings)


def choose_winner(evaluation: FinalistEvaluation) -> str:
    """Return the key of the design that is handed over.

    The winner of the rounds, unless fresh renders show that another finalist is better by more
    than the error bars.
    """
    chosen = "winner"
    for name in evaluation.names:
        if name != chosen and evaluation.difference(chosen, name).interval()[0] > 0:
            chosen = name
    return chosen


def _amount(
    context: RunContext, designs: Sequence[Design], cost: RenderCost | None
) -> dict[str, int]:
    """Return samples per cell and seed, and the seeds of a batch."""

    def choose() -> dict[str, int]:
        if context.fixed is not None:
            return {"samples": context.fixed.final, "seeds": 1}
        assert cost is not None  # with hours it is measured
        phi, _ = distinct_directions(designs)
        jobs = 2 * len(context.bends)
        seeds = -(-2 * cost.workers // jobs) if cost.workers > jobs else 1
        unit = transport_jobs(
            context.scene, phi, context.bends, samples=64, seeds=list(range(seeds))
        )
        free = (context.seconds_left - REPORT_SECONDS) / MIN_BATCHES
        least = MIN_SHARE * (context.until - context.began)
        seconds = max(least, min(2 * cost.fixed * jobs, free))
        return {"samples": samples_within(cost, unit, 64, seconds), "seeds": seeds}

    amount: dict[str, int] = context.decide("final", choose)
    return amount


def _rate(context: RunContext, evaluation: FinalistEvaluation) -> None:
    name = choose_winner(evaluation)
    low, high = evaluation.score(name).score.interval()
    context.keep_best("reference", evaluation.score(name).score.value, (high - low) / 2, name)
