"""From the evaluation of finalists to the finished night: figures, sentences, steps, facts."""

from __future__ import annotations

import timeit
from collections.abc import Callable, Sequence

import numpy as np

from optimize.design import RUN_MODEL
from optimize.overnight.context import RunContext
from optimize.overnight.design_stages import LoopOutcome
from optimize.overnight.result import ConvergencePoint, Finalist, OvernightResult
from optimize.overnight.status import status_of
from optimize.report import parts_moved
from optimize.scoring import predict_design, prediction_checked, student_factor
from optimize.ui.provenance import package_versions
from optimize.verification import FinalistEvaluation
from render.leave_one_out import jackknife_se
from render.preview import Preview
from render.scene import Scene
from surrogate.runtime import MODEL_FILE, Checker, sha256


def conclude(
    context: RunContext,
    checker: Checker,
    loop_outcome: LoopOutcome,
    evaluation: FinalistEvaluation,
    hours: float | None,
) -> OvernightResult:
    """Return the night that is over."""
    finalists = [_finalist(context, checker, evaluation, name) for name in evaluation.names]
    winner = evaluation.best("winner")
    replicates = len(evaluation.renders.replicates)
    verdict = [
        *outcome(context.scene, finalists, winner, replicates),
        *(
            evaluation.comparison(other, winner)
            for other in ("winner", "runner-up", "thesis", "colors")
            if other in evaluation.names and other != winner
        ),
        surrogate_sentence(finalists, winner),
        f"The verification loop stopped because {loop_outcome.reason}.",
    ]
    return OvernightResult(
        scene=context.scene,
        replicates=replicates,
        finalists=tuple(finalists),
        winner=winner,
        verdict=tuple(dict.fromkeys(verdict)),
        steps=_steps(loop_outcome, finalists),
        trade=tuple(
            timed_levels(
                context.scene,
                checker,
                [done.seconds / len(done.proposals) for done in loop_outcome.rounds],
            )
        ),
        facts=_facts(context, loop_outcome, evaluation, hours),
    )


def _finalist(
    context: RunContext, checker: Checker, evaluation: FinalistEvaluation, name: str
) -> Finalist:
    index = evaluation.names.index(name)
    design, settings = evaluation.renders.designs[index], evaluation.settings
    replicates = evaluation.renders.replicates[:, index]
    counts, counts_se = evaluation.renders.counts(settings, index)
    predicted = predict_design(checker, design, context.bends)
    gain = None if name == "baseline" else evaluation.difference("baseline", name)
    return Finalist(
        key=name,
        design=design,
        rating=evaluation.score(name).rating,
        se=evaluation.score(name).score.se,
        gain=None if gain is None else gain.value,
        gain_se=None if gain is None else gain.se,
        predicted=float(predicted["score"]),
        predicted_reach=checker.score_half_width,
        counts=counts,
        counts_se=counts_se,
        predicted_counts=predicted["counts"],
        metric=settings.metric(replicates.mean(axis=0), design.power),
        metric_se=jackknife_se(lambda mean: settings.metric(mean, design.power), replicates),
        converged=not evaluation.doubt(name),
    )


def outcome(scene: Scene, finalists: Sequence[Finalist], winner: str, replicates: int) -> list[str]:
    """Return how much better the design is that is handed over, and what that is made of."""
    entries = {entry.key: entry for entry in finalists}
    first, last, colors = entries["baseline"], entries[winner], entries.get("colors")
    if last.gain is None or last.gain_se is None:
        return [
            f"Nothing that was rendered beats the baseline, which scores {first.score:.1f} ± "
            f"{first.se:.1f}."
        ]
    if not (first.converged and last.converged):
        return [
            f"The design scores {last.score:.1f} ± {last.se:.1f}; the baseline scores "
            f"{first.score:.1f} ± {first.se:.1f}. Renders that have not converged do not say which "
            "one is better."
        ]
    half = student_factor(replicates) * last.gain_se
    sentences = [
        f"The design scores {last.score:.1f} ± {last.se:.1f}; the baseline scores "
        f"{first.score:.1f} ± {first.se:.1f}. Rendered with the same seeds, the gain is "
        f"{last.gain:.1f} ({last.gain / abs(first.score):+.0%}), and its 95% interval reaches "
        f"from {last.gain - half:.1f} to {last.gain + half:.1f}."
    ]
    if winner != "colors" and colors and colors.gain and 0 < colors.gain < last.gain:
        sentences.append(
            f"Of the gain, {colors.gain:+.1f} came with the colors alone, every fiber pointing "
            f"straight in, and {last.gain - colors.gain:+.1f} with the directions."
        )
    return [*sentences, parts_moved(scene, first.rating, last.rating)]


def surrogate_sentence(finalists: Sequence[Finalist], winner: str) -> str:
    """Say how far the surrogate was off, and whether its intervals hold."""
    last = next(entry for entry in finalists if entry.key == winner)
    checks = [entry.prediction_check for entry in finalists]
    untested = checks.count("cannot be tested")
    said = prediction_checked(
        last.predicted - last.score, last.predicted_reach, last.se, converged=last.converged
    )
    return (
        f"The surrogate said {last.predicted:.2f} for this design, {said}. Of {len(checks)} "
        f"finalists it held for {checks.count('holds')}"
        + (f", and for {untested} the renders are too noisy to tell." if untested else ".")
    )


def _steps(
    loop_outcome: LoopOutcome, finalists: Sequence[Finalist]
) -> tuple[ConvergencePoint, ...]:
    """Return what was rendered on the way, for the convergence plot."""
    rounds = [
        (f"round {done.number}", entry.role, rendered.score, entry.score)
        for done in loop_outcome.rounds
        for entry, rendered in zip(done.proposals, done.scores, strict=True)
    ]
    return (
        *(ConvergencePoint(step, role, s.value, s.se, said) for step, role, s, said in rounds),
        *(ConvergencePoint("final", e.key, e.score, e.se, e.predicted) for e in finalists),
    )


def _facts(
    context: RunContext,
    loop_outcome: LoopOutcome,
    evaluation: FinalistEvaluation,
    hours: float | None,
) -> tuple[tuple[str, str], ...]:
    store, scene, status = context.store, context.scene, status_of(context.store.run)
    passes = sum(len(store.decided(f"{n}/table")["seeds"]) for n in range(1, context.number + 1))
    asked = f"{context.samples} samples" if context.samples is not None else f"{hours:g} h"
    versions = package_versions("mitsuba", "drjit", "torch", "onnxruntime", "numpy")
    return (
        ("Scene", f"{scene.name}, {scene.hash}"),
        ("Seed", str(context.seed)),
        ("Asked for", asked),
        ("Time worked", f"{store.spent() / 3600:.3f} h"),
        ("Rendering", f"{status.render_seconds:.0f} s in {status.evaluations} renders"),
        ("Workers", str(context.renders.workers.count)),
        (
            "Transport table",
            f"{passes} passes, {context.decided('table')['samples']} samples per cell in the last",
        ),
        ("Rounds", str(len(loop_outcome.rounds))),
        ("Final verification", f"{len(evaluation.renders.replicates)} replicates"),
        ("Surrogate", sha256((store.run / RUN_MODEL / MODEL_FILE).read_bytes())),
        ("Exposure, lambda", f"{evaluation.settings.exposure:.6g}, {evaluation.settings.lam:.6g}"),
        *((f"Version of {name}", value) for name, value in versions.items()),
    )


TIMED_RUNS = 20
"""Designs whose median time is that of a level."""


def timed_levels(
    scene: Scene, checker: Checker, render_seconds: Sequence[float]
) -> list[tuple[str, float, float, float, float, float]]:
    """Return speed and accuracy of preview, model and renders, from quick to slow.

    Of each its name, seconds per design (measured here) and, from the model's metadata, median and
    95th percentile of the error of facet colors, median error of S, and Kendall's tau.

    ``render_seconds`` are those of renders as noisy as the ones that the model was trained with.
    """
    held = {str(row["level"]): row for row in checker.metadata.held_out}
    bends = np.array(scene.state_axis)
    phi = np.full((1, scene.lamp_count), np.pi / 2)
    power = np.ones((1, scene.lamp_count, 3))
    with Preview(scene) as preview:
        drawn = _median_seconds(lambda: preview.transport(phi[0, :1], bends))
    found = _median_seconds(lambda: checker.run(phi, power, bends))
    rows = [("preview", drawn, "preview")]
    rows += [("surrogate", found, checker.metadata.own_level)]
    if len(render_seconds):
        seconds = float(np.median(render_seconds))
        rows += [("a render of one round", seconds, "noise of the reference")]
    keys = ("facet_median", "facet_p95", "score_median", "kendall_tau")
    errors = {name: [float(held[name][key]) for key in keys] for *_, name in rows if name in held}
    return [
        (title, seconds, *errors[name])  # type: ignore[misc]
        for title, seconds, name in sorted(rows, key=lambda row: row[1])
        if name in errors
    ]


def _median_seconds(work: Callable[[], object]) -> float:
    work()
    return float(np.median(timeit.repeat(work, number=1, repeat=TIMED_RUNS)))
