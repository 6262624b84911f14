"""Writing an exploration: designs, pictures and the report, all at once or not at all."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

from optimize.design.design_file import save_design
from optimize.exploration.explore import Exploration
from optimize.exploration.pictures import explore_pictures
from optimize.report.exploration_report import ReportContent, render_report
from optimize.ui.output import fresh_directory, write_manifest
from optimize.ui.provenance import package_versions

DESIGN, BASELINE, REPORT = "design.json", "baseline.json", "report.html"


def write_exploration(
    exploration: Exploration, target: Path, model: Path, elapsed: Callable[[], float]
) -> dict[str, object]:
    """Write everything into ``target``, which it replaces, and return the result for programs.

    Arguments:
        exploration: what was found.
        target: the directory; an earlier result in it is replaced.
        model: folder of the surrogate, named in the report.
        elapsed: seconds since the command began.
    """
    scene, first, last = exploration.scene, exploration.stages[0], exploration.stages[-1]
    with fresh_directory(target) as folder:
        save_design(folder / BASELINE, first.design, scene, first.rating)
        save_design(folder / DESIGN, last.design, scene, last.rating)
        pictures = dict(explore_pictures(exploration))
        for name, png in pictures.items():
            (folder / f"{name}.png").write_bytes(png)
        html = render_report(
            ReportContent(
                scene=scene,
                stages=exploration.stages,
                pictures=pictures,
                confidence=f"{exploration.checker.coverage:.0%}",
                search_note=_search_note(exploration),
                caveats=caveats(exploration),
                facts=_facts(exploration, model, elapsed()),
                errors=exploration.checker.metadata.held_out,
                made=datetime.now(UTC).strftime("%d %B %Y, %H:%M UTC"),
                verify_command=f"tactilux verify {target / DESIGN}",
            )
        )
        (folder / REPORT).write_text(html, encoding="utf-8")
        result = exploration.to_json(target / DESIGN, target / REPORT, elapsed())
        write_manifest(folder, result)
    return result


def caveats(exploration: Exploration) -> list[str]:
    """Return what the reader must know before believing the numbers."""
    checker = exploration.checker
    return [
        "All scores come from the surrogate (level 1): the preview, corrected by a model that was "
        "fitted to physically based renders. It has not seen this design.",
        f"The intervals held {checker.coverage:.0%} of held-out random designs, within "
        f"{checker.score_reach:.2f} counts of the reference's score. A search picks the best of "
        "many candidates and so finds the surrogate's mistakes too: the true gain is likely to be "
        "smaller than shown.",
        "Both baseline and optimized design share the surrogate's errors in part, so the interval "
        "of their difference is not the sum of the two; only a verification gives it.",
        "The scene is the one described by its file. Values marked as assumed there (see "
        "tactilux describe) have not been calibrated against a real sensor.",
    ]


def _search_note(exploration: Exploration) -> str:
    search = exploration.search
    end = (
        "until a round moved nothing"
        if search.converged
        else "until the rounds ran out, so a longer search may find more"
    )
    rounds = search.history[-1].round
    return (
        f"{search.evaluated:,} designs in {search.seconds:.1f} s: {rounds} "
        f"round{'s' if rounds > 1 else ''} of colors and directions, {end}."
    )


def _facts(exploration: Exploration, model: Path, seconds: float) -> list[tuple[str, str]]:
    scene, about = exploration.scene, exploration.checker.metadata
    checksum = hashlib.sha256((model / "checker.onnx").read_bytes()).hexdigest()
    versions = package_versions("numpy", "onnxruntime", "cma", "moderngl")
    return [
        ("Scene", f"{scene.name}, {scene.hash}"),
        ("Level", "1, surrogate"),
        ("Seed", str(exploration.seed)),
        ("Time", f"{seconds:.1f} s"),
        ("Exposure, λ", f"{about.exposure:.6g}, {about.lam:.6g}"),
        ("Model", f"{model / 'checker.onnx'}, SHA-256 {checksum}"),
        ("Training data", f"SHA-256 {about.training_data_hash}"),
        ("Model's sources", about.git_revision),
        ("Versions", ", ".join(f"{name} {version}" for name, version in versions.items())),
        *_study_facts(exploration),
    ]


def _study_facts(exploration: Exploration) -> list[tuple[str, str]]:
    study, found = exploration.study, []
    if study is None:
        return []
    titles = {stage.key: stage.title for stage in exploration.stages}
    if study.robust:
        lows = [f"{titles[key]} {rating.low:.1f}" for key, rating in study.robust.items()]
        draws = next(iter(study.robust.values())).draws
        found.append((f"Lower 10 % of S on {draws} sensors as built", ", ".join(lows)))
        costs = [f"{entry.name} {entry.low_loss:.1f}" for entry in study.sensitivities]
        found.append(("Loss at that quantile, by tolerance alone", ", ".join(costs)))
    if study.shadows:
        taken = [f"{titles[key]} {value:.1f}" for key, value in study.shadows.items()]
        found.append(("Counts that a bolt's shadows take", ", ".join(taken)))
    return found
