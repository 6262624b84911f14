"""``tactilux explore``: from a scene to a better design, a table and a report."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from typer import Option

from optimize.cli.options import Coarse, Json, ModelFolder, SceneName, Seed
from optimize.ui.console import ProgressBar, note, print_json, reserved_stdout
from render.errors import DesignError
from render.progress import Progress

if TYPE_CHECKING:
    from optimize.exploration import Exploration
    from optimize.search import SearchStep


def run(
    scene_name: SceneName = "finger20",
    out: Annotated[
        Path | None, Option(help="Result directory (default: runs/<scene>-explore).")
    ] = None,
    model: ModelFolder = None,
    coarse: Coarse = False,
    seed: Seed = 0,
    robust: Annotated[
        Literal["quantile", "spread"] | None,
        Option(help="Against the scene's tolerances: lower 10 % quantile, or mean - spread."),
    ] = None,
    shadow: Annotated[
        float | None, Option(min=0.0, help="Weight of the penalty for a bolt's shadows.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Find a better lighting design in seconds."""
    from optimize.design import noise_words
    from optimize.exploration import explore
    from optimize.report import DESIGN, print_scores, warnings, write_exploration
    from optimize.robust import (
        RobustnessStudy,
        print_study,
        study_robustness,
        usual_tolerances_note,
    )
    from optimize.scoring import first_model, is_prompt, open_model
    from optimize.ui.output import check_target, design_in
    from render.describe import stale_sources
    from render.preview.gl import create_context
    from render.scene import load_scene, sources, standalone

    began = time.monotonic()
    with reserved_stdout() as stream:
        scene = load_scene(scene_name)
        kept = standalone(scene)
        for told in stale_sources(scene, sources(scene)):
            note(told)
        if robust is not None:
            for told in usual_tolerances_note(scene):
                note(told)
        if shadow is not None and not math.isfinite(shadow):
            raise DesignError(
                f"--shadow = {shadow}, allowed: a finite weight of at least 0", field="shadow"
            )
        target = out or Path("runs") / f"{scene.name}-explore"
        check_target(target)
        earlier = design_in(target / DESIGN)
        # The pictures need OpenGL: better to miss it now than after the search.
        create_context().release()
        # What takes minutes to answer is answered with few light paths before.
        twice = not coarse and not is_prompt(scene, model)
        for last in (False, True) if twice else (True,):
            checker = open_model(scene, model, coarse=coarse) if last else first_model(scene)
            where = (
                f"its {checker.level}{noise_words(checker.photon_noise)}"
                if checker.file is None
                else f"the surrogate in {checker.file.parent}"
            )  # fmt: skip
            note(f"Exploring {scene.name} on {where}")
            with ProgressBar() as bar:
                found = explore(scene, checker, seed=seed, progress=_Steps(bar))
                if last and (robust is not None or shadow is not None):
                    bar.note("  refining for what was asked")
                    found = study_robustness(found, robust, shadow, bar)
                bar.note("  drawing pictures and the report")
                # Only this command's own first answer gives way: it may be the earlier design.
                keep_other = design_in(target / DESIGN) == earlier
                result = write_exploration(
                    found,
                    kept,
                    target,
                    lambda: time.monotonic() - began,
                    keep_other=keep_other,
                )
            if not last:
                note(_first_answer(found, target, time.monotonic() - began))
        if as_json:
            print_json(stream, result)
        else:
            doubts = warnings(found.stages, found.ranking)
            if not found.ranking.reliable:
                stream.write(f"Note: {doubts.pop(0)}\n")
            print_scores(stream, found.stages, found.checker.coverage)
            if isinstance(found.study, RobustnessStudy):
                print_study(stream, found.study, {e.key: e.title for e in found.stages})
            for warning in doubts:
                stream.write(f"Note: {warning}\n")
            stream.write(f"Design: {result['design']}\nReport: {result['report']}\n")


def _first_answer(found: Exploration, target: Path, seconds: float) -> str:
    """Return what the preview of few paths found, for those who wait for more."""
    from optimize.report import clipping_warning, guessing_warning, preview_warnings

    low, high = found.rating.interval
    checker, last = found.checker, found.stages[-1]
    doubts = preview_warnings(last.scene, checker.level, checker.photon_noise)
    doubts += guessing_warning(last.scene, last.normal_error) + clipping_warning(last.clipped)
    return " ".join(
        [
            f"First answer after {seconds:.0f} s, in {target}: score {found.rating.score:.0f} "
            f"({low:.0f} to {high:.0f}), baseline {found.stages[0].rating.score:.0f}.",
            *doubts,
            "Now for a more exact one",
        ]
    )


class _Steps:
    """Says what every stage of the search reached, and estimates what is left.

    The number of rounds is not known before; two are usual, and later rounds have three stages.
    """

    def __init__(self, bar: ProgressBar) -> None:
        self.bar, self.done, self.expected = bar, 0, 9

    def __call__(self, step: SearchStep) -> None:
        from optimize.report import STAGES

        label = STAGES[step.stage][0]
        self.bar.note(
            f"  {step.seconds:5.1f} s  {label:<17}  score {step.score:8.3f}"
            f"  ({step.evaluated:,} designs)"
        )
        self.done += 1
        if self.done == self.expected:
            self.expected += 3
        self.bar(Progress(self.done, self.expected, stage="exploring"))
