"""Optimizing by renders: the verification loop, the thesis procedure, or both side by side."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Literal

from optimize.design import (
    Design,
    ScoreSettings,
    dimmed_baseline,
    limits_of,
    turning_limits,
)
from optimize.objectives import ERROR_KEYS, ObjectiveName
from optimize.scoring import JackknifeEstimate, RankAgreement, search_table
from optimize.search import population
from optimize.verification.design_renders import RenderDesigns
from optimize.verification.finalists import FinalistEvaluation, evaluate_finalists
from optimize.verification.judges import Judge, judge_of
from optimize.verification.score_allocation import score_allocation
from optimize.verification.thesis import GENERATIONS, ThesisResult, thesis_procedure
from optimize.verification.verification_loop import (
    SEED_STRIDE,
    LoopConfig,
    LoopResult,
    LoopRound,
    SceneRefit,
    VerificationLoop,
)
from render.choose_exposure import scene_scale
from render.geometry import fiber_edges
from render.scene import Scene
from render.transport import TransportTable
from surrogate.runtime import Checker, rendering_seconds

OptimizationMethod = Literal["loop", "thesis", "both"]
THESIS_SEED, FINAL_SEED = 800, 900
"""Added to the render seeds of a loop's seed."""
BUDGET = 1.0 / 20.0
"""Render seconds of the loop and its verdict, in units of the thesis procedure's."""
ROUNDS_SHARE = 0.5
"""Part of them that rounds may take."""
FINALISTS_COST = 1.3
"""Seconds of finalists rendered together, in units of as many samples of one design: 0.9 to 1.3."""


@dataclass(frozen=True)
class OptimizeConfig:
    """What is run and how much is rendered.

    Arguments:
        method: ``loop``, ``thesis`` or ``both``.
        objective: what decides; the thesis's procedure itself searches for S.
        samples: per cell and render, the same for both methods.
        final_samples: per cell, seed and finalist.
        final_seeds: independent renders of a batch of the finalists.
        rounds: of the loop; generations: of the thesis's CMA-ES; both at most.
        seed: of searches and renders.
        timed: the renderer keeps to a time of its own, the finalists' one batch ends with it.
    """

    method: OptimizationMethod = "loop"
    objective: ObjectiveName = "sensor"
    samples: int = 96
    final_samples: int = 192
    final_seeds: int = 2
    rounds: int = 4
    generations: int = GENERATIONS
    seed: int = 0
    timed: bool = False


@dataclass(frozen=True, eq=False)
class Optimization:
    """What was found, by whom, and what it cost.

    Arguments:
        loop, thesis: outcomes of the methods that were run.
        wall: seconds by method, without the final renders.
        finalists: fresh scores of ``baseline``, ``thesis``, ``winner`` and ``runner-up``.
        training_seconds: of rendering that the surrogate took once, for all designs of the scene;
            None where it does not say.
    """

    loop: LoopResult | None
    thesis: ThesisResult | None
    wall: dict[str, float]
    finalists: FinalistEvaluation
    training_seconds: float | None

    @cached_property
    def winner(self) -> str:
        """The finalist that is handed over: the loop's, unless another is shown to be better."""
        return self.finalists.best("winner" if self.loop else "thesis")

    @property
    def all_in_seconds(self) -> float | None:
        """Of rendering since the scene file: training, rounds and verdict of the loop."""
        if self.loop is None or self.training_seconds is None:
            return None
        return self.training_seconds + self.loop.seconds + self.finalists.renders.seconds

    @property
    def design(self) -> Design:
        """The design that is handed over."""
        finalists = self.finalists
        return finalists.renders.designs[finalists.names.index(self.winner)]


def optimize(
    scene: Scene,
    checker: Checker | None,
    render: RenderDesigns,
    config: OptimizeConfig,
    *,
    on_round: Callable[[LoopRound, Judge], None] | None = None,
    on_candidate: Callable[[int, int, float], None] | None = None,
) -> Optimization:
    """Return the outcome of the methods asked for, verified by renders that both share.

    Arguments:
        scene: the sensor.
        checker: its surrogate; the thesis alone can do without.
        render: renders designs together.
        config: what is run.
        on_round: called after every round of the loop, with what judges it.
        on_candidate: called after every generation of the thesis, see `thesis_procedure`.
    """
    baseline, edges = dimmed_baseline(scene), fiber_edges(scene)
    scale = scene_scale(scene) if checker is None else checker
    settings = ScoreSettings(scale.exposure, scale.lam)
    judge = judge_of(config.objective, scene, settings, checker)
    table = None if checker is None else search_table(checker)
    seeds = SEED_STRIDE * (config.seed + 1)
    loop = thesis = None
    wall: dict[str, float] = {}
    finalists = [("baseline", baseline)]
    if config.method != "loop":
        began = time.monotonic()
        thesis = thesis_procedure(
            baseline,
            render,
            edges=edges,
            limits=turning_limits(scene),
            settings=settings,
            samples=config.samples,
            seed=config.seed,
            render_seed=seeds + THESIS_SEED,
            generations=config.generations,
            report=on_candidate,
        )
        wall["thesis"] = time.monotonic() - began
        finalists.append(("thesis", thesis.design))
    if config.method != "thesis" and checker is not None and table is not None:
        began = time.monotonic()
        seconds = math.inf
        if thesis is not None:
            seconds = rounds_seconds(thesis.seconds, thesis.runs, config)
        loop = _run_loop(judge, checker, table, baseline, render, config, seconds, on_round)
        wall["loop"] = time.monotonic() - began
        best = loop.candidates[:2]
        found = zip(("winner", "runner-up"), best, strict=False)
        finalists += [(name, entry.design) for name, entry in found]
    free = 0.0
    if loop is not None and not config.timed:
        least = _least_thesis_seconds(loop, len(set(edges)), config.generations)
        free = BUDGET * (least if thesis is None else thesis.seconds) - loop.seconds
    leader = "thesis" if loop is None else "winner"
    names, designs = zip(*finalists, strict=True)
    evaluation = evaluate_finalists(
        render,
        judge,
        finalists,
        samples=config.final_samples,
        seeds=[seeds + FINAL_SEED + i for i in range(config.final_seeds)],
        leader=leader,
        seconds=free,
        allocation=score_allocation(
            scene, table, settings, designs, leader=names.index(leader), untouched=True
        ),
    )
    if loop is not None and evaluation.best("winner") == "runner-up":
        swapped = {"winner": "runner-up", "runner-up": "winner"}
        renamed = tuple(swapped.get(name, name) for name in evaluation.names)
        evaluation = replace(evaluation, names=renamed)
    return Optimization(loop, thesis, wall, evaluation, _training_seconds(checker))


def rounds_seconds(thesis: float, renders: int, config: OptimizeConfig) -> float:
    """Return the seconds of rendering that rounds may take beside the thesis procedure.

    A part of the loop's, and no more than leaves the finalists their first batch. The procedure
    took ``thesis`` seconds for its ``renders`` of one design each.
    """
    budget = BUDGET * thesis
    batch = config.final_samples * config.final_seeds / config.samples * thesis / renders
    return min(ROUNDS_SHARE * budget, budget - FINALISTS_COST * batch)


def _run_loop(
    judge: Judge,
    checker: Checker,
    table: TransportTable,
    baseline: Design,
    render: RenderDesigns,
    config: OptimizeConfig,
    seconds: float,
    report: Callable[[LoopRound, Judge], None] | None,
) -> LoopResult:
    amount = LoopConfig(config.samples, config.rounds, config.seed, seconds=seconds)
    refit, limits = SceneRefit(judge.scene, checker), limits_of(judge.scene)
    loop = VerificationLoop(judge, table, baseline, render, refit, amount, limits)
    return loop.run(None if report is None else lambda done: report(done, judge))


def _training_seconds(checker: Checker | None) -> float | None:
    """Return what the surrogate's renders took; a preview, which is no file, has none."""
    if checker is None:
        return None
    if checker.file is None:
        return 0.0
    return rendering_seconds(checker.file)


def _least_thesis_seconds(loop: LoopResult, groups: int, generations: int) -> float:
    """Return what the thesis procedure's renders would take, where it is not run.

    It renders one design at a time, which takes no less than a design of the loop's first round,
    and turns at least one group of fibers per edge.
    """
    each = loop.rounds[0].seconds / len(loop.rounds[0].proposals)
    return each * (1 + generations * population(groups))


def optimization_to_json(scene: Scene, outcome: Optimization, design: Path) -> dict[str, object]:
    """Return what programs rely on; ``design`` is where the design lies that is handed over."""
    finalists = outcome.finalists
    result: dict[str, object] = {
        "scene": scene.name,
        "scene_hash": scene.hash,
        "level": "reference",
        "objective": finalists.judge.objective,
        "design": str(design),
        "finalists": {name: _finalist(finalists, name) for name in finalists.names},
        "final_render_seconds": finalists.renders.seconds,
        "surrogate_training_render_seconds": outcome.training_seconds,
        "all_in_render_seconds": {
            "loop": outcome.all_in_seconds,
            "thesis": None if outcome.thesis is None else outcome.thesis.seconds,
        },
        "monochrome": outcome.design.monochrome,
    }
    if outcome.loop is not None:
        result["loop"] = {
            "render_seconds": outcome.loop.seconds,
            "wall_seconds": outcome.wall["loop"],
            "renders": len(outcome.loop.rounds),
            "reason": outcome.loop.reason,
            "verdict": finalists.comparison("runner-up", "winner")
            if "runner-up" in finalists.names
            else None,
            "rounds": [_round(entry, finalists.judge) for entry in outcome.loop.rounds],
        }
    if outcome.thesis is not None:
        result["thesis"] = {
            "render_seconds": outcome.thesis.seconds,
            "wall_seconds": outcome.wall["thesis"],
            "renders": outcome.thesis.runs,
            "converged": outcome.thesis.directions.converged,
            "believed_score": outcome.thesis.score,
        }
    if outcome.loop is not None and outcome.thesis is not None:
        difference = finalists.difference("thesis", "winner")
        result["difference"] = _estimate(difference, finalists.confidence)
    return result


def _estimate(estimate: JackknifeEstimate, confidence: float = 0.95) -> dict[str, object]:
    return {
        "value": estimate.value,
        "se": estimate.se,
        "interval": list(estimate.interval(confidence)),
        "noise_bias": estimate.plain - estimate.value,
    }


def _finalist(finalists: FinalistEvaluation, name: str) -> dict[str, object]:
    """Return S and degrees of a finalist, with what each is more than the baseline's."""
    told: dict[str, object] = {"score": _estimate(finalists.score(name).score), "gain": None}
    for reader, key in ERROR_KEYS.items():
        told[f"{key}_deg"] = _estimate(finalists.error(name, reader))
        told[f"{key}_gain_deg"] = None
    if name != "baseline":
        told["gain"] = _estimate(finalists.difference("baseline", name), finalists.confidence)
        for reader, key in ERROR_KEYS.items():
            gain = finalists.error_difference("baseline", name, reader)
            told[f"{key}_gain_deg"] = _estimate(gain, finalists.confidence)
    return told


def _round(loop_round: LoopRound, judge: Judge) -> dict[str, object]:
    """Return a round in the judge's own unit, counts or degrees."""

    def told(estimate: JackknifeEstimate) -> dict[str, object]:
        return _estimate(estimate if judge.sign > 0 else -estimate)

    gains: list[JackknifeEstimate | None] = [None, *loop_round.gains]
    return {
        "number": loop_round.number,
        "render_seconds": loop_round.seconds,
        "ranking": _agreement(loop_round.agreement),
        "ranking_after_refit": _agreement(loop_round.refitted),
        "refit_prior": loop_round.correction.tau,
        "designs": [
            {
                "role": entry.role,
                **_described(entry.design),
                "predicted": judge.sign * entry.score,
                "spread": entry.spread,
                "rendered": told(rendered),
                "converged": known,
                "gain": None if gain is None else told(gain),
            }
            for entry, rendered, known, gain in zip(
                loop_round.proposals, loop_round.values, loop_round.converged, gains, strict=True
            )
        ],
    }


def _agreement(ranking: RankAgreement) -> dict[str, object]:
    return {"tau": ranking.tau, "decided": ranking.decided, "pairs": ranking.pairs}


def _described(design: Design) -> dict[str, object]:
    return {"phi": design.phi.tolist(), "power": design.drive.tolist()}
