"""``tactilux optimize``: the search in which renders decide, beside the thesis's own procedure."""

from __future__ import annotations

import time
from pathlib import Path
from typing import IO, TYPE_CHECKING, Annotated, Literal

from typer import BadParameter, Option

from optimize.cli.options import MAX_MINUTES, Json, ModelFolder, Objective, SceneName, Seed
from optimize.ui.console import ProgressBar, note, print_json, print_table, reserved_stdout
from render.errors import SceneError

if TYPE_CHECKING:
    from optimize.verification import Judge, LoopRound, Optimization
    from render.scene import Scene
    from surrogate.runtime import Checker


def run(
    scene_name: SceneName = "finger20",
    method: Annotated[
        Literal["loop", "thesis", "both"],
        Option(help="Verification loop, the thesis's procedure, or both side by side."),
    ] = "loop",
    out: Annotated[
        Path | None, Option(help="Result directory (default: runs/<scene>-optimize).")
    ] = None,
    model: ModelFolder = None,
    objective: Objective = None,
    rounds: Annotated[int, Option(min=1, help="Rounds of the loop at most.")] = 4,
    generations: Annotated[
        int, Option(min=1, help="Generations of the thesis's CMA-ES at most.")
    ] = 20,
    samples: Annotated[
        int, Option(min=1, help="Samples per cell of every candidate's render.")
    ] = 96,
    final_samples: Annotated[
        int, Option(min=1, help="Samples per cell and seed of the finalists' renders.")
    ] = 192,
    final_seeds: Annotated[int, Option(min=1, help="Seeds of the finalists' renders.")] = 2,
    minutes: Annotated[
        float | None,
        Option(
            min=0.1, max=MAX_MINUTES, help="Time for everything, instead of samples; the loop's."
        ),
    ] = None,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Search with renders deciding: propose, render, refit."""
    began = time.monotonic()
    if minutes is not None and method != "loop":
        raise BadParameter("--minutes is for --method loop: the thesis's procedure takes its time")
    from optimize.placement import with_places
    from optimize.report import doubts, write_optimization
    from optimize.ui.output import check_target
    from optimize.verification import (
        OptimizeConfig,
        RenderDesigns,
        TimedRenders,
        optimize,
        reference_renders,
    )
    from render.reference import TimeBudget, ensure_llvm
    from render.scene import load_scene, standalone

    with reserved_stdout() as stream:
        sensor = load_scene(scene_name)
        scene = with_places(sensor)
        kept = standalone(scene)
        if method != "loop" and scene.constraints is not None:
            raise SceneError(
                f"scene {scene.name} has constraints, which the thesis's procedure does not know: "
                "use --method loop, or leave the section out to compare",
                field="constraints",
            )
        target = out or Path("runs") / f"{sensor.name}-optimize"
        check_target(target)
        checker = _checker(scene, model, required=method != "thesis")
        ensure_llvm()
        checkpoint = target.parent / f"{target.name}-renders"
        note(f"Renders are kept in {checkpoint}; interrupted, the same command goes on from there")
        with ProgressBar("Rendering") as bar:
            render: RenderDesigns = reference_renders(scene, checkpoint, bar)
            if minutes is not None:
                budget = TimeBudget.of_minutes(minutes, began)
                render = TimedRenders(
                    scene, budget, rounds=rounds, checkpoint=checkpoint, progress=bar
                )
            found = optimize(
                scene,
                checker,
                render,
                OptimizeConfig(
                    method,
                    objective or ("sensor" if method == "loop" else "score"),
                    samples,
                    final_samples,
                    final_seeds,
                    rounds,
                    generations,
                    seed,
                    timed=minutes is not None,
                ),
                on_round=lambda done, judge: _note_round(bar, done, judge),
                on_candidate=lambda *at: bar.note(_candidate_text(*at)),
            )
            bar.note("  drawing pictures and the report")
            result = write_optimization(scene, found, checker, kept, target)
        if as_json:
            print_json(stream, result)
        else:
            _print(stream, scene, found)
            for doubt in doubts(scene, found):
                stream.write(f"Note: {doubt}\n")
            stream.write(f"Design: {result['design']}\nReport: {result['report']}\n")


def _checker(scene: Scene, model: Path | None, *, required: bool) -> Checker | None:
    """Return the surrogate; the thesis can do without."""
    from optimize.scoring import open_model, trained_model

    if not required and trained_model(scene, model) is None:
        note("There is no surrogate: exposure and lambda come from the preview")
        return None
    return open_model(scene, model)


def _note_round(bar: ProgressBar, done: LoopRound, judge: Judge) -> None:
    """Say what a round found, line by line."""
    bar.note(f"  Round {done.number}: {done.seconds:.0f} s of rendering")
    rows = zip(done.proposals, [None, *done.gains], done.values, done.converged, strict=True)
    for entry, gain, measured, converged in rows:
        over = ""
        if gain is not None:
            over = f", over the baseline {judge.told(gain.value, '+')} ± {gain.se:.2f}"
        bar.note(
            f"    {entry.role:<10} predicted {judge.told(entry.score)}, rendered "
            f"{judge.told(measured.value)} ± {measured.se:.2f} "
            f"(with noise {judge.told(measured.plain)}){over}"
            f"{'' if converged else ', not converged'}"
        )
    tau = done.correction.tau
    learned = f"prior {tau:g} per coefficient" if tau else "no correction that renders bear out"
    bar.note(f"    ranking: {done.agreement.shown}; refit: {learned}, then {done.refitted.shown}")


def _candidate_text(done: int, limit: int, best: float) -> str:
    """Say how far the thesis's procedure is."""
    return f"  Thesis: {done} candidates of at most {limit}, best plain score {best:.2f}"


def _print(stream: IO[str], scene: Scene, found: Optimization) -> None:
    from optimize.objectives import READERS
    from optimize.report import TITLES, conclusions

    finalists, rows = found.finalists, []
    for name in finalists.names:
        read = [f"{finalists.error(name, reader).shown()}°" for reader in READERS]
        gain = "" if name == "baseline" else finalists.difference("baseline", name).shown("+")
        score = finalists.score(name).score.shown()
        rows.append((TITLES[name], *read, score, gain, *_costs(found, name)))
    print_table(
        stream,
        f"{scene.name}, {scene.hash}, reference",
        (
            "design",
            *(f"{reader} reader" for reader in READERS),
            "score S",
            "over baseline",
            "renders",
            "render s",
            "wall s",
        ),
        rows,
    )
    for sentence in conclusions(found):
        stream.write(f"{sentence}\n")


def _costs(found: Optimization, name: str) -> tuple[str, str, str]:
    if name == "thesis" and found.thesis is not None:
        wall = found.wall["thesis"]
        return str(found.thesis.runs), f"{found.thesis.seconds:.0f}", f"{wall:.0f}"
    if name == "winner" and found.loop is not None:
        wall = found.wall["loop"]
        return str(len(found.loop.rounds)), f"{found.loop.seconds:.0f}", f"{wall:.0f}"
    return "", "", ""
