"""``tactilux explore``: from a scene to a better design, a table and a report."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import IO, TYPE_CHECKING, Annotated, Literal

from typer import Option

from optimize.cli.options import Coarse, Json, ModelFolder, Objective, SceneName, Seed
from optimize.ui.console import ProgressBar, note, print_json, reserved_stdout
from render.errors import DesignError
from render.progress import Progress, in_stage

if TYPE_CHECKING:
    from optimize.design import Design
    from optimize.exploration import Exploration
    from optimize.objectives import ObjectiveName
    from optimize.search import SearchStep
    from render.scene import Scene, StandaloneScene
    from surrogate.runtime import Checker


def run(
    scene_name: SceneName = "finger20",
    out: Annotated[
        Path | None, Option(help="Result directory (default: runs/<scene>-explore).")
    ] = None,
    model: ModelFolder = None,
    coarse: Coarse = False,
    objective: Objective = None,
    seed: Seed = 0,
    place: Annotated[
        bool, Option("--place", help="Lamps may sit elsewhere: on [search.places], or any edge.")
    ] = False,
    lamps: Annotated[
        int | None, Option(min=1, help="At most so many lit (default: as the scene says).")
    ] = None,
    parts: Annotated[
        str | None,
        Option(metavar="NAME,NAME", help="LEDs that lamps may be, of tactilux parts."),
    ] = None,
    shots: Annotated[
        int | None, Option(min=1, help="Pictures one after the other (default: as the scene says).")
    ] = None,
    robust: Annotated[
        Literal["quantile", "spread"] | None,
        Option(help="For sensors as built: what one in ten is worse than, or mean and spread."),
    ] = None,
    shadow: Annotated[
        float | None, Option(min=0.0, help="Weight of the penalty to S for a bolt's shadows.")
    ] = None,
    vary: Annotated[
        list[str] | None,
        Option(
            metavar="KEY=LOW:HIGH:STEP",
            help="Vary a number of the file, each value with its own best lights; repeatable.",
        ),
    ] = None,
    lamps_follow: Annotated[
        bool, Option("--lamps-follow", help="Lamps rise and sink with a pad.thickness of --vary.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Find a better lighting design in seconds."""
    from optimize.placement import SearchSpace

    names = None if parts is None else tuple(name.strip() for name in parts.split(","))
    space = SearchSpace(place, lamps, names, shots)
    if vary or lamps_follow:
        from optimize.dimensions.vary_command import explore_dimensions

        refused: dict[str, object] = {"--model": model, "--robust": robust, "--shadow": shadow}
        return explore_dimensions(
            scene_name,
            vary or [],
            lamps_follow=lamps_follow,
            space=space,
            out=out,
            coarse=coarse,
            objective=objective,
            seed=seed,
            as_json=as_json,
            refused=[name for name, value in refused.items() if value is not None],
        )
    from optimize.design import noise_words
    from optimize.exploration import explore
    from optimize.placement import (
        reads_worse,
        refined_places,
        refined_sentence,
    )
    from optimize.report import DESIGN, write_exploration
    from optimize.robust import study_robustness
    from optimize.scoring import first_model, is_prompt, open_model
    from optimize.ui.output import check_target, design_in
    from render.describe import stale_sources
    from render.preview.gl import create_context
    from render.scene import load_scene, sources, standalone

    began = time.monotonic()
    with reserved_stdout() as stream:
        sensor = load_scene(scene_name)
        place = space.places_on(sensor)
        scene = space.on(sensor)
        kept = standalone(scene)
        for told in stale_sources(scene, sources(scene)):
            note(told)
        goal = _goal(scene, objective, robust, shadow)
        refined = robust is not None or shadow is not None
        target = out or Path("runs") / f"{sensor.name}-explore"
        check_target(target)
        earlier = design_in(target / DESIGN)
        # The pictures need OpenGL: better to miss it now than after the search.
        create_context().release()

        def explored(scene: Scene, checker: Checker, *starts: Design) -> Exploration:
            where = (
                f"its {checker.level_name}{noise_words(checker.photon_noise)}"
                if checker.file is None
                else f"the surrogate in {checker.file.parent}"
            )
            note(f"Exploring {scene.name} on {where}")
            with ProgressBar() as bar:
                return explore(
                    scene,
                    checker,
                    objective=goal,
                    seed=seed,
                    starts=starts,
                    progress=_Steps(bar),
                    report=in_stage(bar, f"for the {goal} reader"),
                )

        def written(found: Exploration, kept: StandaloneScene) -> dict[str, object]:
            # Only this command's own first answer gives way: it may be the earlier design.
            keep_other = design_in(target / DESIGN) == earlier
            note("  drawing pictures and the report")
            return write_exploration(
                found,
                kept,
                target,
                lambda: time.monotonic() - began,
                keep_other=keep_other,
            )

        # What takes minutes to answer is answered with few light paths before.
        again = not coarse and not is_prompt(scene, model)
        checker = first_model(scene) if again else open_model(scene, model, coarse=coarse)
        found = explored(scene, checker)
        if again:
            written(found, kept)
            note(_first_answer(found, target, time.monotonic() - began))
        better = None
        if place and checker.file is None:
            with ProgressBar("Refining places") as bar:
                better = refined_places(sensor, scene, found.design, goal, bar, traced=again)
        finer = scene if better is None else better.scene
        if better is not None:
            note(refined_sentence(better, goal))
        if again or better is not None:
            starts = () if better is None else (better.design,)
            second = explored(finer, open_model(finer, model, coarse=coarse), *starts)
            # On one level, places that are finer and read worse are not taken.
            if again or not reads_worse(second, found):
                found, kept = second, kept if better is None else standalone(finer)
        if refined:
            with ProgressBar() as bar:
                bar.note("  refining for what was asked")
                found = study_robustness(found, robust, shadow, bar)
        result = written(found, kept)
        if as_json:
            print_json(stream, result)
        else:
            _print_found(stream, found, place=place)
            stream.write(f"Design: {result['design']}\nReport: {result['report']}\n")


def _goal(
    scene: Scene, objective: ObjectiveName | None, robust: str | None, shadow: float | None
) -> ObjectiveName:
    """Return what is improved, and note the tolerances that are assumed.

    Raises:
        DesignError: the weight of shadows is no number, or goes with no reader.
    """
    from optimize.robust import usual_tolerances_note

    if robust is not None:
        for told in usual_tolerances_note(scene):
            note(told)
    if shadow is not None and not math.isfinite(shadow):
        raise DesignError(
            f"--shadow = {shadow}, allowed: a finite weight of at least 0", field="shadow"
        )
    if shadow is not None and objective not in {None, "score"}:
        raise DesignError(
            f"--objective = {objective} with --shadow, which weighs counts of S, allowed: "
            "score; leave one of them out",
            field="objective",
        )
    return objective or ("sensor" if shadow is None else "score")


def _print_found(stream: IO[str], found: Exploration, *, place: bool) -> None:
    """Print the table of the stages, what a placement moved, and what is doubtful."""
    from optimize.placement import moved_sentence, parts_sentence
    from optimize.report import print_scores, warnings
    from optimize.robust import RobustnessStudy, print_study

    doubts = warnings(found.stages, found.ranking, found.objective)
    if not found.ranking.reliable:
        stream.write(f"Note: {doubts.pop(0)}\n")
    print_scores(stream, found.stages, found.checker.coverage)
    if isinstance(found.study, RobustnessStudy):
        print_study(stream, found.study, {e.key: e.title for e in found.stages})
    if place:
        stream.write(f"{moved_sentence(found)}\n")
    if found.scene.search and found.scene.search.parts:
        stream.write(f"{parts_sentence(found)}\n")
    for warning in doubts:
        stream.write(f"Note: {warning}\n")


def _first_answer(found: Exploration, target: Path, seconds: float) -> str:
    """Return what the surrogate of few paths found, for those who wait for more."""
    from optimize.report import clipping_warning, guessing_warning, preview_warnings

    low, high = found.rating.interval
    checker, first, last = found.checker, found.stages[0], found.stages[-1]
    read = ""
    if found.objective != "score":
        errors = (stage.error(found.objective) for stage in (last, first))
        read = "{} reader {:.2f}°, baseline {:.2f}°; ".format(found.objective, *errors)
    doubts = preview_warnings(last.scene, checker.level, checker.photon_noise)
    doubts += guessing_warning(last.scene, last.reader_error) + clipping_warning(last.clipped)
    return " ".join(
        [
            f"First answer after {seconds:.0f} s, in {target}: {read}score "
            f"{found.rating.score:.0f} ({low:.0f} to {high:.0f}), baseline "
            f"{first.rating.score:.0f}.",
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
