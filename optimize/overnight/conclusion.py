"""From the evaluation of finalists to the finished night: figures, sentences, steps, facts."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np

from optimize.overnight.context import RunContext
from optimize.overnight.design_stages import TITLES, LoopOutcome, choose_winner
from optimize.overnight.result import ConvergencePoint, Finalist, OvernightResult
from optimize.scoring import JackknifeEstimate, check_interval, jackknife_se, predict_design
from optimize.ui.provenance import package_versions
from optimize.verification import FinalistEvaluation
from surrogate.runtime import MODEL_FILE, Checker, sha256

TIMED_RUNS = 20
"""Designs whose median time is that of a level."""


def conclude(
    context: RunContext,
    checker: Checker,
    loop_outcome: LoopOutcome,
    evaluation: FinalistEvaluation,
    checks: Sequence[tuple[int, FinalistEvaluation]],
    hours: float | None,
) -> OvernightResult:
    """Return the night that is over."""
    winner = choose_winner(evaluation)
    return OvernightResult(
        scene=context.scene,
        settings=evaluation.settings,
        replicates=len(evaluation.renders.replicates),
        finalists=tuple(
            _finalist(context, checker, evaluation, index) for index in range(len(evaluation.names))
        ),
        winner=winner,
        verdict=_sentences(context, checker, loop_outcome, evaluation, winner),
        steps=_steps(context, loop_outcome, checks, checker),
        trade=_trade(context, checker, loop_outcome),
        facts=_facts(context, loop_outcome, evaluation, hours),
    )


def _finalist(
    context: RunContext, checker: Checker, evaluation: FinalistEvaluation, index: int
) -> Finalist:
    name, design = evaluation.names[index], evaluation.renders.designs[index]
    replicates = evaluation.renders.replicates[:, index]
    settings, score = evaluation.settings, evaluation.scores[index].score
    counts, counts_se = evaluation.renders.counts(settings, index)
    predicted = predict_design(checker, design, context.bends)
    gain = None if name == "baseline" else evaluation.difference("baseline", name)
    return Finalist(
        key=name,
        title=TITLES[name],
        design=design,
        score=score.value,
        se=score.se,
        gain=None if gain is None else gain.value,
        gain_se=None if gain is None else gain.se,
        predicted=float(predicted["score"]),
        predicted_reach=checker.score_half_width,
        counts=counts,
        counts_se=counts_se,
        predicted_counts=predicted["counts"],
        metric=settings.metric(replicates.mean(axis=0), design.power),
        metric_se=jackknife_se(lambda mean: settings.metric(mean, design.power), replicates),
    )


def _sentences(
    context: RunContext,
    checker: Checker,
    loop_outcome: LoopOutcome,
    evaluation: FinalistEvaluation,
    winner: str,
) -> tuple[str, ...]:
    names, sentences = evaluation.names, []
    if winner != "baseline":
        sentences.append(evaluation.comparison("baseline", winner))
    sentences += [
        evaluation.comparison(other, winner)
        for other in ("runner-up", "thesis", "colors", "winner")
        if other in names and other != winner
    ]
    index = names.index(winner)
    design, score = evaluation.renders.designs[index], evaluation.score(winner).score
    error = float(predict_design(checker, design, context.bends)["score"]) - score.value
    half_width = checker.score_half_width
    sentences.append(
        f"The surrogate is off by {error:+.2f} for the {winner}: "
        f"its 90% interval of ±{half_width:.2f} "
        f"{check_interval(error, half_width, score.se)} (renders ±{score.se:.2f})."
    )
    sentences.append(f"The verification loop stopped because {loop_outcome.reason}.")
    if design.monochrome:
        sentences.append(
            "The optimum is monochrome: the weight of the color term does not reward color "
            "differences in this scene."
        )
    return tuple(sentences)


def _steps(
    context: RunContext,
    loop_outcome: LoopOutcome,
    checks: Sequence[tuple[int, FinalistEvaluation]],
    checker: Checker,
) -> tuple[ConvergencePoint, ...]:
    spent = context.store.render_seconds_by_kind()
    before = sum(
        seconds for kind, seconds in spent.items() if _precedes_rounds(kind, context.number)
    )
    steps = []

    def add(
        stage: str,
        number: int,
        role: str,
        seconds: float,
        score: JackknifeEstimate,
        predicted: float,
    ) -> None:
        steps.append(
            ConvergencePoint(stage, number, role, seconds, score.value, score.se, predicted)
        )

    for done in loop_outcome.rounds:
        before += done.seconds
        for entry, rendered in zip(done.proposals, done.scores, strict=True):
            add("rounds", done.number, entry.role, before, rendered.score, entry.score)
    for number, evaluation in checks:
        renders, scores = evaluation.renders, evaluation.scores
        for name, design, rendered in zip(evaluation.names, renders.designs, scores, strict=True):
            predicted = float(predict_design(checker, design, context.bends)["score"])
            add("final", number, name, before + renders.seconds, rendered.score, predicted)
    return tuple(steps)


def _precedes_rounds(kind: str, number: int) -> bool:
    period, _, stage = kind.partition("/")
    return int(period) < number or (int(period) == number and stage in ("trial", "table"))


def _trade(
    context: RunContext, checker: Checker, loop_outcome: LoopOutcome
) -> tuple[dict[str, float | str | None], ...]:
    """Return speed and accuracy by level: the model's held-out errors and measured times."""
    held = {str(row["level"]): row for row in checker.metadata.held_out}
    rendered = [done.seconds / len(done.proposals) for done in loop_outcome.rounds]
    phi = np.full((1, context.scene.fibers.count), np.pi / 2)
    power = np.ones((1, context.scene.fibers.count, 3))

    def model() -> None:
        checker.run(phi, power, context.bends)

    kind = str(checker.metadata.residual["kind"])
    rows: list[tuple[str, str, float]] = [
        ("preview", "preview", _preview_seconds(context)),
        ("surrogate", kind, _median_seconds(model)),
    ]
    if rendered:
        rows.append(("a render of one round", "noise of the reference", float(np.median(rendered))))
    return tuple(
        {
            "level": title,
            "seconds_per_design": seconds,
            "facet_error_median": float(held[name]["facet_median"]),
            "facet_error_p95": float(held[name]["facet_p95"]),
            "score_error": float(held[name]["score_median"]),
            "kendall_tau": float(held[name]["kendall_tau"]),
        }
        for title, name, seconds in rows
        if name in held
    )


def _preview_seconds(context: RunContext) -> float:
    from render.preview import Preview

    with Preview(context.scene) as preview:

        def draw() -> None:
            preview.transport(np.array([np.pi / 2]), context.bends)

        return _median_seconds(draw)


def _median_seconds(work: Callable[[], None]) -> float:
    work()
    spent = []
    for _ in range(TIMED_RUNS):
        began = time.perf_counter()
        work()
        spent.append(time.perf_counter() - began)
    return float(np.median(spent))


def _facts(
    context: RunContext,
    loop_outcome: LoopOutcome,
    evaluation: FinalistEvaluation,
    hours: float | None,
) -> tuple[tuple[str, str], ...]:
    store, scene = context.store, context.scene
    table = context.decided("table")
    passes = sum(len(store.decided(f"{n}/table")["seeds"]) for n in range(1, context.number + 1))
    asked = f"{context.fixed.samples} samples" if context.fixed is not None else f"{hours:g} h"
    versions = package_versions("mitsuba", "drjit", "torch", "onnxruntime", "numpy")
    return (
        ("Scene", f"{scene.name}, {scene.hash}"),
        ("Seed", str(context.seed)),
        ("Asked for", asked),
        ("Time worked", f"{store.spent() / 3600:.3f} h"),
        ("Rendering", f"{store.render_seconds():.0f} s in {store.evaluations()} renders"),
        ("Workers", str(context.renders.workers.count)),
        ("Transport table", f"{passes} passes, {table['samples']} samples per cell in the last"),
        ("Rounds", str(len(loop_outcome.rounds))),
        ("Final verification", f"{len(evaluation.renders.replicates)} replicates"),
        ("Surrogate", sha256((store.run / "model" / MODEL_FILE).read_bytes())),
        ("Exposure, lambda", f"{evaluation.settings.exposure:.6g}, {evaluation.settings.lam:.6g}"),
        *((f"Version of {name}", value) for name, value in versions.items()),
    )
