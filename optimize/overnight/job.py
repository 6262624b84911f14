"""The overnight job: from a scene to a verified design, its report and a refitted model.

Every stage asks the record first, so the job may be ended at any instant and asked for again. With
some more hours than a finished run has worked, its finalists get more seeds, which are pooled with
those that they had. With so many more that all stages gain, another shift refines: more passes of
the table, the model fitted to all of them, rounds from the contenders so far, and fresh seeds for
the verdict.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import IO

from optimize.overnight.amounts import Fixed
from optimize.overnight.conclusion import concluded
from optimize.overnight.errors import RunError, writing
from optimize.overnight.final_stage import chosen_finalists, verify_finalists
from optimize.overnight.lock import LOCK, locked
from optimize.overnight.loop_stage import run_loop
from optimize.overnight.model_stage import fitted_model
from optimize.overnight.night import SCENE, Night, NightError, keep_scene
from optimize.overnight.report import REPORT, write_report
from optimize.overnight.runner import StoredRenders
from optimize.overnight.scaling import write_scaling
from optimize.overnight.search_stage import searched, thesis_design
from optimize.overnight.shift import Shift, extended
from optimize.overnight.store import RECORD, Request, Store
from optimize.overnight.table_stage import measured_pace, render_table, seen_pace, whole_table
from optimize.overnight.watch import LOG, Signals, Stopped, Watch
from optimize.overnight.workers import Workers
from optimize.scoring.score_scale import Scale
from render.errors import SceneError
from render.scene.schema import Scene, load_scene
from render.transport import TransportTable

WORTH = 1.05
"""Hours beyond what was worked by less than this factor change nothing."""
REFINES = 1.8
"""From this factor on another shift refines; a shorter one would know less than the first did."""


@dataclass(frozen=True)
class NightConfig:
    """What is asked for.

    Arguments:
        hours: of work, over all attempts together; None where ``samples`` are given.
        samples: of the transport table per cell; everything else follows from it.
        seed: of everything.
    """

    hours: float | None = 8.0
    samples: int | None = None
    seed: int = 0


def overnight(
    scene_name: str,
    run: Path,
    config: NightConfig,
    *,
    hire: Callable[[], Workers],
    lines: IO[str] | None = None,
) -> Night:
    """Do the job in ``run`` and return the finished night.

    Arguments:
        scene_name: a shipped scene, or a file.
        run: the run directory, new or of an earlier call.
        config: what is asked for.
        hire: starts who renders, after everything else has been checked.
        lines: where progress goes as JSON lines.

    Raises:
        RunError: the directory is in use, for something else, full, read-only or damaged.
        Stopped: a signal asked for the end; what is finished is kept.
    """
    scene = load_scene(scene_name)
    check_directory(run)
    with writing(run):
        run.mkdir(parents=True, exist_ok=True)
        with locked(run):
            signals, watch = Signals(), Watch(run, lines)
            try:
                with signals.caught():
                    return _work(scene, scene_name, run, config, hire, signals, watch)
            finally:
                watch.close()


def check_directory(run: Path) -> None:
    """Refuse a place that holds something else.

    Raises:
        RunError: it is a file, or holds files but no record of a run.
    """
    if run.exists() and not run.is_dir():
        raise RunError(f"{run} is not a directory: choose another place with --out", field="out")
    if run.exists() and not (run / RECORD).exists():
        others = {item.name for item in run.iterdir()} - {LOCK, LOG}
        if others:
            raise RunError(
                f"{run} holds files but no run ({RECORD}), so it is left alone: choose another "
                "place with --out",
                field="out",
                value=str(run),
            )


def _work(
    scene: Scene,
    scene_name: str,
    run: Path,
    config: NightConfig,
    hire: Callable[[], Workers],
    signals: Signals,
    watch: Watch,
) -> Night:
    limits = scene.model_dump_json(include={"constraints"})
    request = Request(
        scene.hash, hashlib.sha256(limits.encode()).hexdigest()[:16], config.seed, config.samples
    )
    store, ended = Store(run, request, watch.note), "error"
    workers: Workers | None = None
    try:
        _keep_scene(run, scene_name, scene)
        number, extension, finished = _place(store, config)
        if finished:
            ended = "finished"
            try:
                night = Night.load(run)
            except NightError as error:
                watch.note(f"{error}; doing so now")
            else:
                watch.note(f"{run} is finished: ask for more hours, or for another --out")
                if not (run / REPORT).is_file():
                    write_report(night, run)
                return night
        workers = hire()
        shift = _shift(scene, store, workers, signals, watch, config, number, extension)
        night = _shifted(shift, config)
        ended = "finished"
        return night
    except Stopped as stop:
        ended = "stopped"
        watch.note(f"Stopped; give the same command again to go on: {run}")
        raise stop
    finally:
        if workers is not None:
            workers.close()
        store.close(ended)


def _keep_scene(run: Path, scene_name: str, scene: Scene) -> None:
    """Copy the scene's file into the run, unless a whole copy is there."""
    try:
        if load_scene(run / SCENE) == scene:
            return
    except SceneError:
        pass
    keep_scene(run, scene_name)


def _place(store: Store, config: NightConfig) -> tuple[int, int, bool]:
    """Return the shift to work in, how often it was extended, and whether nothing is left to do."""
    number = 1
    while store.decided(f"{number + 1}/hours") is not None:
        number += 1
    ends = _ends(store, number)
    if not ends or store.decided(extended(f"{number}/hours", ends)) is not None:
        return number, ends, False
    factor = 0.0 if config.hours is None else 3600 * config.hours / store.spent()
    if factor >= REFINES:
        return number + 1, 0, False
    return (number, ends, False) if factor > WORTH else (number, ends - 1, True)


def _ends(store: Store, number: int) -> int:
    """Return how often a shift has come to its end, extensions included."""
    ends = 0
    while store.decided(extended(f"{number}/finished", ends)) is not None:
        ends += 1
    return ends


def _shift(
    scene: Scene,
    store: Store,
    workers: Workers,
    signals: Signals,
    watch: Watch,
    config: NightConfig,
    number: int,
    extension: int,
) -> Shift:
    began = 0.0
    if number > 1:
        last = _ends(store, number - 1) - 1
        began = store.decided(extended(f"{number - 1}/finished", last))["spent"]
    store.decide(extended(f"{number}/hours", extension), lambda: {"hours": config.hours})
    shift = Shift(
        scene=scene,
        store=store,
        renders=StoredRenders(store, workers, signals),
        watch=watch,
        seed=config.seed,
        number=number,
        extension=extension,
        fixed=None if config.samples is None else Fixed(config.samples),
        until=math.inf if config.hours is None else 3600 * config.hours,
        began=began,
    )
    watch.record = lambda stage, done, total, eta: store.progress(
        stage, done, total, eta, shift.best
    )
    return shift


def _shifted(shift: Shift, config: NightConfig) -> Night:
    """Return the night after all stages of the shift."""
    render_table(shift, None if shift.fixed is not None else measured_pace(shift))
    pace = seen_pace(shift)

    @cache
    def table() -> TransportTable:
        return whole_table(shift)

    checker = fitted_model(shift, table)
    colored, best = searched(shift, checker)
    thesis = thesis_design(shift, table, checker)
    outcome = run_loop(shift, checker, best, pace)
    finalists = chosen_finalists(shift, colored, thesis, outcome)
    scale = Scale(checker.exposure, checker.lam)
    verdict, checks = verify_finalists(shift, finalists, scale, pace)
    shift.watch.stage("Report")
    night = concluded(shift, checker, outcome, verdict, checks, config.hours)
    night.save(shift.store.run)
    write_scaling(shift.store.run)
    write_report(night, shift.store.run)
    spent = shift.store.spent()
    shift.decide(extended("finished", shift.extension), lambda: {"spent": spent})
    shift.watch.record("Finished", 1, 1, 0.0)
    for sentence in night.verdict:
        shift.watch.note(sentence)
    return night
