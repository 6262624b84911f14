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
from contextlib import closing
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import IO, Any

from optimize.design import keep_scene
from optimize.objectives import ObjectiveName
from optimize.overnight.conclusion import conclude
from optimize.overnight.context import RunContext
from optimize.overnight.design_stages import (
    choose_finalists,
    run_loop,
    search_designs,
    thesis_design,
    verify_finalists,
)
from optimize.overnight.result import OvernightResult
from optimize.overnight.run_directory import (
    REPORT,
    RunError,
    check_run_directory,
    locked,
    writing,
)
from optimize.overnight.run_log import RunLog
from optimize.overnight.store import Request, Store
from optimize.overnight.surrogate_stages import fit_model, pooled_table, render_table
from optimize.overnight.workers import StoredRenders, Workers
from optimize.ui.process import Signals, Stopped
from render.errors import TactiluxError
from render.files import make_folder
from render.progress import Progress
from render.scene import Scene, as_scene, standalone
from render.transport import TransportTable

EXTEND_FACTOR = 1.05
"""Hours beyond what was worked by less than this factor change nothing."""
REFINE_FACTOR = 1.8
"""From this factor on another period refines; a shorter one would know less than the first did."""


def overnight(
    scene: Scene | str | Path,
    run: Path,
    *,
    hours: float | None = None,
    samples: int | None = None,
    seed: int = 0,
    objective: ObjectiveName = "sensor",
    make_workers: Callable[[], Workers],
    lines: IO[str] | None = None,
) -> OvernightResult:
    """Do the job in ``run`` and return the finished night.

    ``hours`` of work are over all attempts together, None where ``samples`` of the transport table
    per cell are given, from which everything else follows. ``objective`` decides between designs:
    degrees of the ``sensor`` or the ``place`` reader, or ``score``. ``make_workers`` starts who
    renders, after everything else has been checked; progress goes to ``lines`` as JSON lines.

    Raises:
        OutputError: the place holds something else.
        RunError: the directory is in use, for something else, full, read-only or damaged.
        Stopped: a signal asked for the end; what is finished is kept.
    """
    scene = as_scene(scene)
    asked = _Asked(scene, hours, samples, seed, objective)
    kept = standalone(scene)
    check_run_directory(run)
    with writing(run):
        make_folder(run)
        with locked(run), closing(RunLog(run, lines)) as log:
            signals, store, ended = Signals(), None, "error"
            try:
                with signals.caught():
                    store = Store(run, asked.request, log.note)
                    keep_scene(run, kept)
                    result = _work(asked, store, make_workers, signals, log)
                ended = "finished"
                return result
            except Stopped:
                ended = "stopped"
                log.note(f"Stopped; give the same command again to go on: {run}")
                raise
            except TactiluxError as error:
                log.keep(f"Ended by an error: {error}")
                raise
            finally:
                if store is not None:
                    store.close(ended)


@dataclass(frozen=True)
class _Asked:
    """What a night is asked for, see `overnight`."""

    scene: Scene
    hours: float | None
    samples: int | None
    seed: int
    objective: ObjectiveName

    @property
    def request(self) -> Request:
        """What the same run is asked for by all attempts."""
        constraints = self.scene.model_dump_json(include={"constraints"})
        limits = hashlib.sha256(constraints.encode()).hexdigest()
        return {
            "the scene of hash": self.scene.hash,
            "constraints of hash": limits[:16],
            "--seed": self.seed,
            "--samples": self.samples,
            "--objective": self.objective,
        }


def _work(
    asked: _Asked,
    store: Store,
    make_workers: Callable[[], Workers],
    signals: Signals,
    log: RunLog,
) -> OvernightResult:
    """Return the finished night, after all that remains to do."""
    turn, period = _turn(store, asked.hours)
    if store.decided(f"finished {turn}") is not None:
        try:
            result = OvernightResult.load(store.run)
        except RunError as error:
            log.note(f"{error}; doing so now")
        else:
            log.note(f"{store.run} is finished: ask for more hours, or for another --out")
            result.save(store.run)  # whatever became of its files
            if not (store.run / REPORT).is_file():
                from optimize.overnight.report import write_report

                write_report(result, store.run)
            return result
    workers = make_workers()
    try:
        context = RunContext(
            scene=asked.scene,
            store=store,
            renders=StoredRenders(store, workers, signals),
            log=log,
            seed=asked.seed,
            objective=asked.objective,
            samples=asked.samples,
            until=math.inf if asked.hours is None else 3600 * asked.hours,
            **period,
        )
        log.record = lambda stage, at: store.progress(stage, at, context.best)
        result = _run_stages(context, asked.hours)
        store.decide(f"finished {turn}", store.spent)
    finally:
        workers.close()
    log.record("Finished", Progress(1, 1, eta_seconds=0.0))
    for sentence in result.verdict:
        log.keep(sentence)
    return result


def _turn(store: Store, hours: float | None) -> tuple[int, dict[str, Any]]:
    """Return how often a finished run was asked for more, and what its last turn works at.

    That is the number of its period, how often the period was extended, and the seconds that were
    worked before it. A turn that is finished begins another where the hours are worth it.
    """
    turn, period = 0, {"number": 1, "extension": 0, "began": 0.0}
    while store.decided(f"finished {turn}") is not None:
        more = store.decided(f"turn {turn + 1}")
        if more is None:
            spent = store.spent()
            factor = 0.0 if hours is None else 3600 * hours / spent
            if factor <= EXTEND_FACTOR:
                break
            refined = {"number": period["number"] + 1, "extension": 0, "began": spent}
            extended = period | {"extension": period["extension"] + 1}
            chosen = refined if factor >= REFINE_FACTOR else extended
            more = store.decide(f"turn {turn + 1}", partial(dict, chosen))
        turn, period = turn + 1, more
    return turn, period


def _run_stages(context: RunContext, hours: float | None) -> OvernightResult:
    """Return the night after all stages of the period."""
    render_table(context)

    @cache
    def table() -> TransportTable:
        return pooled_table(context)

    checker = fit_model(context, table)
    before, best = search_designs(context, checker)
    thesis = thesis_design(context, table, checker)
    loop_outcome = run_loop(context, checker, best)
    finalists = choose_finalists(context, before, thesis, loop_outcome)
    evaluation = verify_finalists(context, finalists, checker)
    context.log.stage("Report")
    result = conclude(context, checker, loop_outcome, evaluation, hours)
    result.save(context.store.run)
    # Matplotlib takes half a second to import, which an attempt that ends before need not wait for.
    from optimize.overnight.report import write_report

    write_report(result, context.store.run)
    return result
