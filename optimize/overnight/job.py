"""The overnight job: from a scene to a verified design, its report and a refitted model.

Every stage asks the record first, so the job may be ended at any instant and asked for again. With
some more hours than a finished run has worked, its finalists get more seeds, which are pooled with
those that they had. With so many more that all stages gain, another period refines: more passes of
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

from optimize.design import ScoreSettings
from optimize.overnight.conclusion import conclude
from optimize.overnight.context import FixedBudget, RunContext, extended
from optimize.overnight.design_stages import (
    choose_finalists,
    run_loop,
    search_designs,
    thesis_design,
    verify_finalists,
)
from optimize.overnight.report import REPORT, write_report
from optimize.overnight.result import SCENE, OvernightResult, ResultError, keep_scene
from optimize.overnight.run_directory import LOCK, RunError, locked, writing
from optimize.overnight.run_log import LOG, RunLog, Signals, Stopped
from optimize.overnight.scaling import write_scaling
from optimize.overnight.store import RECORD, RunRequest, Store
from optimize.overnight.surrogate_stages import (
    fit_model,
    measured_cost,
    observed_cost,
    pooled_table,
    render_table,
)
from optimize.overnight.workers import StoredRenders, Workers
from render.errors import SceneError
from render.scene import Scene, load_scene
from render.transport import TransportTable

EXTEND_FACTOR = 1.05
"""Hours beyond what was worked by less than this factor change nothing."""
REFINE_FACTOR = 1.8
"""From this factor on another period refines; a shorter one would know less than the first did."""


@dataclass(frozen=True)
class OvernightConfig:
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
    config: OvernightConfig,
    *,
    make_workers: Callable[[], Workers],
    lines: IO[str] | None = None,
) -> OvernightResult:
    """Do the job in ``run`` and return the finished night.

    Arguments:
        scene_name: a shipped scene, or a file.
        run: the run directory, new or of an earlier call.
        config: what is asked for.
        make_workers: starts who renders, after everything else has been checked.
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
            signals, log = Signals(), RunLog(run, lines)
            try:
                with signals.caught():
                    return _work(scene, scene_name, run, config, make_workers, signals, log)
            finally:
                log.close()


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
    config: OvernightConfig,
    make_workers: Callable[[], Workers],
    signals: Signals,
    log: RunLog,
) -> OvernightResult:
    limits = scene.model_dump_json(include={"constraints"})
    request = RunRequest(
        scene.hash, hashlib.sha256(limits.encode()).hexdigest()[:16], config.seed, config.samples
    )
    store, ended = Store(run, request, log.note), "error"
    workers: Workers | None = None
    try:
        _keep_scene(run, scene_name, scene)
        number, extension, finished = _position(store, config)
        if finished:
            ended = "finished"
            try:
                result = OvernightResult.load(run)
            except ResultError as error:
                log.note(f"{error}; doing so now")
            else:
                log.note(f"{run} is finished: ask for more hours, or for another --out")
                if not (run / REPORT).is_file():
                    write_report(result, run)
                return result
        workers = make_workers()
        renders = StoredRenders(store, workers, signals)
        context = _context(scene, renders, log, config, number, extension)
        result = _run_stages(context, config)
        ended = "finished"
        return result
    except Stopped as stop:
        ended = "stopped"
        log.note(f"Stopped; give the same command again to go on: {run}")
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


def _position(store: Store, config: OvernightConfig) -> tuple[int, int, bool]:
    """Return the working period, how often it was extended, and whether nothing remains to do."""
    number = 1
    while store.decided(f"{number + 1}/hours") is not None:
        number += 1
    ends = _finish_count(store, number)
    if not ends or store.decided(extended(f"{number}/hours", ends)) is not None:
        return number, ends, False
    factor = 0.0 if config.hours is None else 3600 * config.hours / store.spent()
    if factor >= REFINE_FACTOR:
        return number + 1, 0, False
    return (number, ends, False) if factor > EXTEND_FACTOR else (number, ends - 1, True)


def _finish_count(store: Store, number: int) -> int:
    """Return how often a period has come to its end, extensions included."""
    ends = 0
    while store.decided(extended(f"{number}/finished", ends)) is not None:
        ends += 1
    return ends


def _context(
    scene: Scene,
    renders: StoredRenders,
    log: RunLog,
    config: OvernightConfig,
    number: int,
    extension: int,
) -> RunContext:
    store, began = renders.store, 0.0
    if number > 1:
        last = _finish_count(store, number - 1) - 1
        began = store.decided(extended(f"{number - 1}/finished", last))["spent"]
    store.decide(extended(f"{number}/hours", extension), lambda: {"hours": config.hours})
    context = RunContext(
        scene=scene,
        store=store,
        renders=renders,
        log=log,
        seed=config.seed,
        number=number,
        extension=extension,
        fixed=None if config.samples is None else FixedBudget(config.samples),
        until=math.inf if config.hours is None else 3600 * config.hours,
        began=began,
    )
    log.record = lambda stage, done, total, eta: store.progress(
        stage, done, total, eta, context.best
    )
    return context


def _run_stages(context: RunContext, config: OvernightConfig) -> OvernightResult:
    """Return the night after all stages of the period."""
    render_table(context, None if context.fixed is not None else measured_cost(context))
    cost = observed_cost(context)

    @cache
    def table() -> TransportTable:
        return pooled_table(context)

    checker = fit_model(context, table)
    colored, best = search_designs(context, checker)
    thesis = thesis_design(context, table, checker)
    loop_outcome = run_loop(context, checker, best, cost)
    finalists = choose_finalists(context, colored, thesis, loop_outcome)
    settings = ScoreSettings(checker.exposure, checker.lam)
    verdict, checks = verify_finalists(context, finalists, settings, cost)
    context.log.stage("Report")
    result = conclude(context, checker, loop_outcome, verdict, checks, config.hours)
    result.save(context.store.run)
    write_scaling(context.store.run)
    write_report(result, context.store.run)
    spent = context.store.spent()
    context.decide(extended("finished", context.extension), lambda: {"spent": spent})
    context.log.record("Finished", 1, 1, 0.0)
    for sentence in result.verdict:
        context.log.note(sentence)
    return result
