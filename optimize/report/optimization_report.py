"""The result of the search in which renders decide: designs, the report, and what a builder needs.

It is written together, all at once or not at all.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from optimize.design import Array, Design, Rating, keep_scene, kept_name, save_design
from optimize.mounting import mount, mounting_error_costs, surrogate_score
from optimize.objectives import ERROR_KEYS, READERS
from optimize.readers import CameraModel
from optimize.report.exploration_report import DESIGN, REPORT, score_row
from optimize.report.illustrations import design_pictures
from optimize.report.page import (
    Steps,
    building_steps,
    clipping_warning,
    holder_warning,
    monochrome_warning,
    render_page,
    sensor_figure,
    stage_pictures,
)
from optimize.report.wiring import wiring_context, wiring_files, write_wiring
from optimize.ui.output import fresh_directory, write_manifest
from optimize.ui.provenance import package_versions
from optimize.verification import (
    FinalistEvaluation,
    Judge,
    LoopRound,
    Optimization,
    optimization_to_json,
)
from render.files import write_text
from render.scene import Scene, StandaloneScene
from surrogate.runtime import Checker

FILES = {
    "baseline": "baseline.json",
    "thesis": "thesis.json",
    "winner": "loop.json",
    "runner-up": "runner-up.json",
}
"""Designs that are not handed over."""
TITLES = {
    "baseline": "Baseline",
    "thesis": "Thesis procedure",
    "winner": "Verification loop",
    "runner-up": "Its runner-up",
}


@dataclass(frozen=True, eq=False)
class _Rendered:
    """A finalist as its renders show it."""

    key: str
    title: str
    design: Design
    rating: Rating
    clipped: float
    metric: Array
    counts: Array
    error_map: None = None


def write_optimization(
    scene: Scene,
    outcome: Optimization,
    checker: Checker | None,
    kept: StandaloneScene,
    target: Path,
) -> dict[str, object]:
    """Write designs, record, report and wiring into ``target``; return the result for programs.

    An earlier result in ``target`` is replaced, or kept under a number where it found another
    design. The surrogate prices rounding; the thesis can do without. A copy of ``kept``, the
    scene's file as it was read, stays with the designs.
    """
    finalists = outcome.finalists
    with fresh_directory(target, keep=DESIGN) as folder:
        keep_scene(folder, kept)
        for name, design in zip(finalists.names, finalists.renders.designs, strict=True):
            file = DESIGN if name == outcome.winner else FILES[name]
            save_design(folder / file, design, scene, finalists.rating(name))
        score = None if checker is None else surrogate_score(checker, scene)
        mounting = mount(scene, outcome.design, score)
        no_jig = write_wiring(folder, mounting)
        wiring = wiring_context(
            mounting,
            TITLES[outcome.winner],
            () if checker is None else mounting_error_costs(checker, scene, mounting.design),
            wiring_files(target / DESIGN, no_jig),
            finalists.rating(outcome.winner).read,
        )
        steps = building_steps(target / DESIGN, kept_name(kept, target))
        write_text(folder / REPORT, _page(scene, outcome, wiring, steps))
        result = optimization_to_json(scene, outcome, target / DESIGN)
        result["report"] = str(target / REPORT)
        result["warnings"] = doubts(scene, outcome)
        write_manifest(folder, result)
    return result


def conclusions(outcome: Optimization) -> list[str]:
    """Return what the finalists' renders say, and why the search ended, as sentences."""
    finalists, sentences = outcome.finalists, []
    for name in ("baseline", "runner-up", "winner", "thesis"):
        if name in finalists.names and name != outcome.winner:
            sentences.append(finalists.comparison(name, outcome.winner))
    sentences += [degrees_sentence(finalists, outcome.winner)] if sentences else []
    if outcome.loop is not None:
        sentences.append(f"The loop stopped because {outcome.loop.reason}.")
        sentences.append(_render_seconds(outcome))
    return sentences


def degrees_sentence(finalists: FinalistEvaluation, winner: str) -> str:
    """Say by how many degrees readers miss normals of the winner, beside the baseline's."""
    said = []
    for reader in READERS:
        first, last = (finalists.error(name, reader) for name in ("baseline", winner))
        said.append(f"{last.value:.2f}° (with the baseline {first.value:.2f}°)")
    return (
        f"The sensor reader misses surface normals of the {winner} by {said[0]}, the place reader "
        f"by {said[1]}."
    )


def _render_seconds(outcome: Optimization) -> str:
    """Say what was rendered since the scene file, beside what the thesis procedure renders."""
    assert outcome.loop is not None
    parts = (
        f"{outcome.loop.seconds:.0f} s in rounds and {outcome.finalists.renders.seconds:.0f} s for "
        "the verdict"
    )
    if outcome.all_in_seconds is None:
        text = f"The loop rendered {parts}; what its surrogate took is not known"
    else:
        surrogate = f"{outcome.training_seconds:.0f} s for the surrogate, once for all designs"
        if outcome.training_seconds == 0.0:
            surrogate = "none for the preview, which stands for the surrogate"
        text = (
            f"All in, from the scene file on, the loop took {outcome.all_in_seconds:.0f} s of "
            f"rendering: {surrogate}, {parts}"
        )
    if outcome.thesis is not None:
        text += f"; the thesis procedure took {outcome.thesis.seconds:.0f} s"
    return text + "."


def doubts(scene: Scene, outcome: Optimization) -> list[str]:
    """Return what makes the design that is handed over doubtful; usually nothing."""
    clipped = outcome.finalists.score(outcome.winner).clipped
    texts = holder_warning(scene, outcome.design) + monochrome_warning(outcome.design)
    return texts + clipping_warning(clipped)


def _page(
    scene: Scene,
    outcome: Optimization,
    wiring: dict[str, object],
    steps: Steps,
) -> str:
    shown = [_rendered(outcome, name) for name in outcome.finalists.names]
    pictures = dict(design_pictures(scene, shown))
    rows = []
    for entry in shown:
        score = outcome.finalists.score(entry.key).score
        row = {**score_row(entry), **stage_pictures(pictures, entry.key)}
        row |= {"score": f"{score.value:.1f} ± {score.se:.1f}", "gain": "–"}
        row["best"] = "best" if entry.key == outcome.winner else ""
        if entry.key != "baseline":
            gain = outcome.finalists.difference("baseline", entry.key)
            row["gain"] = f"{gain.value:+.1f} ± {gain.se:.1f}"
        for reader, key in ERROR_KEYS.items():
            error = outcome.finalists.error(entry.key, reader)
            row[key] = f"{error.value:.2f}° ± {error.se:.2f}"
        rows.append(row)
    seconds = outcome.finalists.renders.seconds
    facts = [
        ("Scene", f"{scene.name}, {scene.hash}"),
        ("Level", "reference, bidirectional, MIS"),
        ("Finalists' renders", f"{seconds:.0f} s, {len(outcome.finalists.renders.replicates)} "
         "replicates"),
        *((f"Seconds of the {name}", f"{wall:.0f}") for name, wall in outcome.wall.items()),
        ("Versions", ", ".join(f"{n} {v}" for n, v in package_versions("mitsuba").items())),
    ]  # fmt: skip
    context = {
        "scene": scene.name,
        "scene_hash": scene.hash,
        "bends": scene.state_axis,
        "word": scene.state_word,
        "lam": f"{outcome.finalists.settings.lam:.4g}",
        "conclusions": conclusions(outcome),
        "sensor": sensor_figure(scene),
        "warnings": doubts(scene, outcome),
        "camera": CameraModel.of(scene).sentence,
        "stages": rows,
        "rounds": [
            _round_row(done, outcome.finalists.judge)
            for done in (outcome.loop.rounds if outcome.loop else ())
        ],
        "wiring": wiring,
        "facts": facts,
        "steps": steps,
    }
    return render_page("optimization.html.j2", context)


def _rendered(outcome: Optimization, name: str) -> _Rendered:
    finalists, index = outcome.finalists, outcome.finalists.names.index(name)
    design, settings = finalists.renders.designs[index], finalists.settings
    transport = finalists.renders.replicates[:, index].mean(axis=0)
    score = finalists.score(name)
    return _Rendered(
        key=name,
        title=TITLES[name],
        design=design,
        rating=score.rating,
        clipped=score.clipped,
        metric=settings.metric(transport, design.power),
        counts=settings.counts(transport, design.power),
    )


def _round_row(done: LoopRound, judge: Judge) -> dict[str, str]:
    """Return a round as text: what was rendered, and whether the surrogate ranked it rightly."""
    said = [
        f"{entry.role} {judge.told(measured.value)}{'' if converged else ', not converged'} "
        f"(predicted {judge.told(entry.score)})"
        for entry, measured, converged in zip(
            done.proposals, done.values, done.converged, strict=True
        )
    ]
    return {
        "number": str(done.number),
        "designs": "; ".join(said),
        "ranking": done.agreement.shown,
        "refitted": done.refitted.shown,
        "seconds": f"{done.seconds:.0f}",
    }
