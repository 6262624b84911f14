"""From the evaluation of finalists to the finished night: figures, sentences, steps, facts."""

from __future__ import annotations

import timeit
from collections.abc import Callable, Sequence

import numpy as np

from optimize.design import RUN_MODEL
from optimize.objectives import READERS, ObjectiveName, unit_of
from optimize.overnight.context import RunContext
from optimize.overnight.design_stages import LoopOutcome
from optimize.overnight.result import ConvergencePoint, Finalist, OvernightResult, RenderedFigure
from optimize.overnight.status import status_of
from optimize.readers import CameraModel, expected_error
from optimize.report import parts_moved
from optimize.scoring import (
    predict_design,
    predicted_colors,
    prediction_checked,
    student_factor,
)
from optimize.ui.provenance import package_versions
from optimize.verification import FinalistEvaluation, Judge
from render.leave_one_out import jackknife_se
from render.preview import Preview
from render.scene import Scene
from surrogate.runtime import MODEL_FILE, Checker, sha256
from surrogate.runtime.metadata import NOISE


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
        *outcome(context.scene, finalists, winner, replicates, context.objective),
        *(
            evaluation.comparison(other, winner)
            for other in ("winner", "runner-up", "thesis", "colors", "score")
            if other in evaluation.names and other != winner
        ),
        surrogate_sentence(finalists, winner),
        f"The verification loop stopped because {loop_outcome.reason}.",
    ]
    return OvernightResult(
        scene=context.scene,
        objective=context.objective,
        replicates=replicates,
        finalists=tuple(finalists),
        winner=winner,
        verdict=tuple(dict.fromkeys(verdict)),
        steps=_steps(loop_outcome, finalists, evaluation.judge),
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
    said = predicted_colors(checker, design)[None]
    errors, camera = {}, CameraModel.of(context.scene)
    for reader in READERS:
        error = evaluation.error(name, reader)
        more = None if gain is None else evaluation.error_difference("baseline", name, reader)
        errors[reader] = RenderedFigure(
            value=error.value,
            se=error.se,
            gain=None if more is None else more.value,
            gain_se=None if more is None else more.se,
            predicted=float(expected_error(reader, context.scene, camera).degrees(said)[0]),
        )
    return Finalist(
        key=name,
        design=design,
        rating=evaluation.rating(name),
        se=evaluation.score(name).score.se,
        gain=None if gain is None else gain.value,
        gain_se=None if gain is None else gain.se,
        predicted=float(predicted["score"]),
        predicted_reach=checker.score_half_width,
        errors=errors,
        counts=counts,
        counts_se=counts_se,
        predicted_counts=predicted["counts"],
        metric=settings.metric(replicates.mean(axis=0), design.power),
        metric_se=jackknife_se(lambda mean: settings.metric(mean, design.power), replicates),
        converged=not evaluation.doubt(name),
    )


def outcome(
    scene: Scene,
    finalists: Sequence[Finalist],
    winner: str,
    replicates: int,
    objective: ObjectiveName,
) -> list[str]:
    """Return how much better the design is that is handed over, and what that is made of."""
    entries = {entry.key: entry for entry in finalists}
    first, last, colors = entries["baseline"], entries[winner], entries.get("colors")
    before, after = first.figure(objective), last.figure(objective)
    unit, digits = unit_of(objective), 1 if objective == "score" else 2

    def pm(figure: RenderedFigure) -> str:
        return f"{figure.value:.{digits}f}{unit} ± {figure.se:.{digits}f}{unit}"

    if after.gain is None or after.gain_se is None:
        has = "which scores" if objective == "score" else f"read by the {objective} reader to"
        return [f"Nothing that was rendered beats the baseline, {has} {pm(before)}."]
    both = f"The design scores {pm(after)}; the baseline scores {pm(before)}."
    if objective != "score":
        both = (
            f"The {objective} reader misses surface normals of the design by {pm(after)}, those of "
            f"the baseline by {pm(before)}."
        )
    if not (first.converged and last.converged):
        return [f"{both} Renders that have not converged do not say which one is better."]
    half = student_factor(replicates) * after.gain_se
    low, high = (f"{end:.{digits}f}{unit}" for end in (after.gain - half, after.gain + half))
    sentences = [
        f"{both} Rendered with the same seeds, the {'gain' if not unit else 'difference'} is "
        f"{after.gain:.{digits}f}{unit} ({after.gain / abs(before.value):+.0%}), and its 95% "
        f"interval reaches from {low} to {high}."
    ]
    if objective != "score":
        others = [
            f"the {reader} reader misses {last.errors[reader].value:.2f}° "
            f"({first.errors[reader].value:.2f}° with the baseline)"
            for reader in READERS
            if reader != objective
        ]
        others.append(f"S is {last.score:.1f} ({first.score:.1f} of the baseline)")
        said = " and ".join(others)
        return [*sentences, f"{said[0].upper()}{said[1:]}."]
    if winner != "colors" and colors and colors.gain and 0 < colors.gain < after.gain:
        sentences.append(
            f"Of the gain, {colors.gain:+.1f} came with the colors alone, every fiber pointing "
            f"straight in, and {after.gain - colors.gain:+.1f} with the directions."
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
    loop_outcome: LoopOutcome, finalists: Sequence[Finalist], judge: Judge
) -> tuple[ConvergencePoint, ...]:
    """Return what was rendered on the way, for the convergence plot."""
    rounds = [
        (f"round {done.number}", entry.role, rendered, entry.score)
        for done in loop_outcome.rounds
        for entry, rendered in zip(done.proposals, done.values, strict=True)
    ]
    sign = judge.sign
    final = [(entry.key, entry.figure(judge.objective)) for entry in finalists]
    return (
        *(
            ConvergencePoint(step, role, sign * found.value, found.se, sign * said)
            for step, role, found, said in rounds
        ),
        *(ConvergencePoint("final", key, f.value, f.se, f.predicted) for key, f in final),
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
    about, own = checker.metadata, checker.metadata.own_errors
    held = {str(row["name"]): row for row in about.held_out}
    bends = np.array(scene.state_axis)
    phi = np.full((1, scene.lamp_count), np.pi / 2)
    power = np.ones((1, scene.lamp_count, 3))
    with Preview(scene) as preview:
        drawn = _median_seconds(lambda: preview.transport(phi[0, :1], bends))
    found = _median_seconds(lambda: checker.run(phi, power, bends))
    # A model whose renders bear nothing out is its preview: one row.
    rows = {about.preview_name: (drawn, held.get(about.preview_name))}
    rows[checker.level_name] = found, own
    if len(render_seconds):
        rows["a render of one round"] = float(np.median(render_seconds)), held.get(NOISE)
    keys = ("facet_median", "facet_p95", "score_median", "kendall_tau")
    return [
        (title, seconds, *(float(errors[key]) for key in keys))  # type: ignore[misc]
        for title, (seconds, errors) in sorted(rows.items(), key=lambda row: row[1][0])
        if errors is not None
    ]


def _median_seconds(work: Callable[[], object]) -> float:
    work()
    return float(np.median(timeit.repeat(work, number=1, repeat=TIMED_RUNS)))
