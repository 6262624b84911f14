"""``tactilux frontier``: what every level of the ladder costs, and how wrong it is."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import IO, TYPE_CHECKING, Annotated

from typer import Argument, Option

from optimize.cli.options import MAX_MINUTES, Json, ModelFolder, Seed
from optimize.ui.console import (
    ProgressBar,
    counted,
    duration,
    note,
    print_json,
    print_table,
    reserved_stdout,
)
from render.errors import SceneError

if TYPE_CHECKING:
    from optimize.frontier import Frontier, Survey
    from optimize.frontier.held_out import FrontierRow
    from render.scene import Scene

RESULT, PLOT, SURVEY = "frontier.json", "frontier.png", "survey.json"
LEAST_MINUTES = 3.0
"""For a scene."""
WIDTH = 130


def run(
    scene_names: Annotated[
        list[str] | None,
        Argument(
            metavar="[SCENE]...",
            help="Names of shipped scenes, TOML files, or folders of them (default: finger20).",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        Option(help="Run directory (default: runs/<scene>-frontier, of several runs/frontier)."),
    ] = None,
    model: ModelFolder = None,
    designs: Annotated[int, Option(min=2, help="Random held-out designs.")] = 30,
    minutes: Annotated[
        float, Option(min=LEAST_MINUTES, max=MAX_MINUTES, help="Time for everything together.")
    ] = 30.0,
    samples: Annotated[
        int | None,
        Option(min=32, help="Samples per cell of the reference: the same work on any machine."),
    ] = None,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Measure what every level costs and how wrong it is."""
    began = time.monotonic()
    from optimize.frontier import surveyed_scenes
    from render.reference import ensure_llvm

    with reserved_stdout() as stream:
        scenes = surveyed_scenes(scene_names or ["finger20"])
        ensure_llvm()
        common = _Common(designs, seed, samples)
        if len(scenes) == 1:
            (scene,) = scenes.values()
            folder = out or Path("runs") / f"{scene.name}-frontier"
            _run_one(stream, scene, folder, model, common, minutes, began, as_json)
            return
        if model is not None:
            raise SceneError(
                f"--model {model} is of one scene, allowed: no --model with "
                f"{counted(len(scenes), 'scene')}; models are found by the scenes' hashes",
                field="model",
            )
        least = LEAST_MINUTES * len(scenes)
        if samples is None and minutes < least:
            raise SceneError(
                f"minutes = {minutes:g} for {counted(len(scenes), 'scene')}, allowed: {least:g} or "
                f"more, {LEAST_MINUTES:g} for each; give more or name fewer scenes",
                field="minutes",
            )
        _run_many(stream, scenes, out or Path("runs") / "frontier", common, minutes, as_json)


class _Common:
    """What all scenes share: held-out designs, seed, and samples where they are given."""

    def __init__(self, designs: int, seed: int, samples: int | None) -> None:
        self.designs, self.seed, self.samples = designs, seed, samples

    def measure(
        self,
        scene: Scene,
        folder: Path,
        model: Path | None,
        minutes: float,
        began: float,
        renderers: bool,
    ) -> Frontier:
        """Measure one scene."""
        from optimize.frontier import measure_frontier
        from optimize.scoring import trained_model
        from render.reference import TimeBudget

        with ProgressBar("" if renderers else f"{scene.name}:", announce=renderers) as report:
            return measure_frontier(
                scene,
                trained_model(scene, model),
                folder,
                count=self.designs,
                seed=self.seed,
                budget=TimeBudget.of_minutes(minutes, began),
                samples=self.samples,
                renderers=renderers,
                report=report,
            )


def _run_one(
    stream: IO[str],
    scene: Scene,
    folder: Path,
    model: Path | None,
    common: _Common,
    minutes: float,
    began: float,
    as_json: bool,
) -> None:
    from optimize.frontier.plot import frontier_png
    from optimize.frontier.predictors import SETUP
    from optimize.ui.output import check_target, write_result

    check_target(folder, SETUP)
    note(f"Interrupted, the same command goes on from {folder}")
    found = common.measure(scene, folder, model, minutes, began, renderers=True)
    result = found.to_json() | {"plot": str(folder / PLOT)}
    text = json.dumps(result, indent=2, allow_nan=False) + "\n"
    write_result(folder / PLOT, frontier_png(found))
    write_result(folder / RESULT, text.encode())
    if as_json:
        print_json(stream, result)
    else:
        _print(stream, found, folder)


def _run_many(
    stream: IO[str],
    scenes: dict[str, Scene],
    folder: Path,
    common: _Common,
    minutes: float,
    as_json: bool,
) -> None:
    from optimize.frontier import survey
    from optimize.frontier.plot import survey_png
    from optimize.ui.output import check_target, write_result
    from optimize.ui.provenance import program_version
    from render.files import write_json

    check_target(folder, SURVEY)
    each = minutes / len(scenes)
    asked = {"names": list(scenes), "seed": common.seed, "designs": common.designs}
    write_json(folder / SURVEY, asked)
    note(f"Interrupted, the same command goes on from {folder}")

    def question(scene: Scene) -> dict[str, object]:
        effort = {"minutes": each} if common.samples is None else {"samples": common.samples}
        about = {"scene_hash": scene.hash, "seed": common.seed, "designs": common.designs}
        return about | effort | {"version": program_version()}

    def begin(name: str, after: int) -> None:
        left = "" if common.samples else f", {duration(60 * each * (after + 1))} left for all"
        note(f"{name}, {len(scenes) - after} of {len(scenes)}{left}")

    def measure(scene: Scene, own: Path) -> Frontier:
        return common.measure(scene, own, None, each, time.monotonic(), renderers=False)

    found = survey(scenes, folder, question, measure, time.monotonic, begin)
    result = found.to_json() | {"plot": str(folder / PLOT)}
    write_result(folder / PLOT, survey_png(found))
    write_result(folder / RESULT, (json.dumps(result, indent=2, allow_nan=False) + "\n").encode())
    if as_json:
        print_json(stream, result)
    else:
        _print_survey(stream, found, folder)


HEADINGS = (
    "prediction", "ready after", "per design", "color error", "no noise", "95 %", "rms, no noise",
    "S off by", "tau", "S held",
)  # fmt: skip


def _cells(row: FrontierRow) -> tuple[str, ...]:
    held = row.interval
    return (
        row.name,
        f"{row.setup_seconds + row.seconds_per_design:.2g} s",
        f"{row.seconds_per_design:.2g} s",
        f"{row.facet_median:.1%}",
        f"{row.facet_median_true:.1%}",
        f"{row.facet_p95:.1%}",
        f"{row.facet_rms_true:.1%}",
        f"{row.score_median:.2f}",
        f"{row.kendall_tau:.2f}",
        "" if held is None else f"{held.score:.0%} (± {held.half_width:.1f})",
    )


def _photon_noise(rows: Sequence[FrontierRow]) -> list[str]:
    """Return what levels say of the noise of their own photons."""
    from optimize.design import noise_words

    return [
        f"{row.name}{noise_words(row.photon_noise)}" for row in rows if row.photon_noise is not None
    ]


def _print(stream: IO[str], found: Frontier, folder: Path) -> None:
    reference = found.reference
    print_table(
        stream,
        f"{reference.designs.scene.name}: {found.plan.designs} random held-out designs",
        HEADINGS,
        [_cells(row) for row in (*found.rows, found.noise)],
        width=WIDTH,
    )
    for said in _photon_noise(found.rows):
        stream.write(f"{said.capitalize()}.\n")
    for name, reason in found.left_out.items():
        stream.write(f"No row of {name}: {reason}.\n")
    stream.write(
        f"Reference: bidirectional, MIS, {found.plan.samples} samples per cell, "
        f"{reference.seconds:.0f} s; its scores are known to {reference.score_se:.2f} counts.\n"
        f"S held: how many of the reference's scores a row's 90% intervals hold.\n"
        f"One design alone takes {found.seconds_alone:.0f} s at {found.plan.short[-1]} samples.\n"
        f"Plot: {folder / PLOT}\nJSON: {folder / RESULT}\n"
    )


def _print_survey(stream: IO[str], found: Survey, folder: Path) -> None:
    rows = [
        (scene.scene, *_cells(row))
        for scene in found.scenes
        for row in (*scene.rows, scene.noise)
        if row is not None
    ]
    print_table(
        stream,
        "All scenes",
        ("scene", *HEADINGS),
        rows,
        words=("scene", "prediction"),
        width=WIDTH + 20,
    )
    print_table(
        stream,
        "Over scenes",
        ("prediction", "scenes", "ready after", "per design", "color error, no noise",
         "worst scene", "tau", "noise leaves at least", "S held"),
        [
            (
                rung.rung,
                str(rung.scenes),
                f"{rung.ready_seconds:.2g} s",
                f"{rung.seconds_per_design:.2g} s",
                f"{rung.facet_median:.1%}",
                f"{rung.facet_worst:.1%}",
                f"{rung.kendall_tau:.2f}",
                f"{rung.noise_tau:.2f}",
                "" if rung.score_coverage is None else f"{rung.score_coverage:.0%}",
            )
            for rung in found.summary()
        ],
        width=WIDTH,
    )  # fmt: skip
    for scene in found.scenes:
        if scene.failed:
            stream.write(f"{scene.scene} was not measured: {scene.failed}\n")
        for said in _photon_noise(scene.rows):
            stream.write(f"{scene.scene}: {said}.\n")
        for name, reason in scene.left_out.items():
            stream.write(f"{scene.scene} has no row of {name}: {reason}.\n")
    stream.write(f"Plot: {folder / PLOT}\nJSON: {folder / RESULT}\n")
