"""What is known of a run, also while another process works in it; nothing is written."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, NotRequired

from pydantic import Field, TypeAdapter, ValidationError
from typing_extensions import TypedDict

from optimize.objectives import ObjectiveName, title_of, unit_of
from optimize.overnight.run_directory import holder, open_record, writing
from optimize.overnight.store import check_request
from optimize.ui.console import duration
from render.levels import level_name, read_level

WORKERS = (1, 2, 8, 64)


@dataclass(frozen=True)
class RunStatus:
    """How far a run is.

    Arguments:
        state: ``running``, ``finished``, or what goes on when asked: ``stopped``, ``lost`` (its
            process was killed) or ``failed`` (an error ended it, which its log tells).
        stage: what it does, or did last; share: how much of that is done, 0 to 1.
        best: ``objective``, ``value`` (counts or degrees), ``interval`` (or nothing), ``level``,
            ``effort`` and ``design`` of the best so far.
        evaluations: finished renders; render_seconds: theirs, on whatever machine.
        seconds: worked by all attempts together; attempts: how many there were.
        eta_seconds: until the end; None when nobody works or nobody knows.
        holder: who works in it now.
    """

    state: str
    stage: str
    share: float
    best: dict[str, Any] | None
    evaluations: int
    render_seconds: float
    seconds: float
    attempts: int
    eta_seconds: float | None
    holder: str | None

    @property
    def best_words(self) -> str:
        """The best design so far with its figure, in one line; "" without one."""
        if self.best is None:
            return ""
        objective, ends = self.best["objective"], self.best["interval"]
        figure = f"{title_of(objective)} {self.best['value']:.2f}{unit_of(objective)}"
        if ends is not None:
            figure += f" ({ends[0]:.2f} to {ends[1]:.2f})"
        level = level_name(self.best["level"], self.best["effort"])
        return f"{figure}, {level}: {self.best['design']}"


def status_of(run: Path) -> RunStatus:
    """Return how far the run in ``run`` is.

    Raises:
        RunError: there is no run, it is of another version, or damaged.
    """
    working = holder(run)
    with writing(run), closing(open_record(run)) as db:
        check_request(run, db, None)
        evaluations, render_seconds = db.execute(
            "SELECT COUNT(DISTINCT key), TOTAL(seconds) FROM evaluations"
        ).fetchone()
        seconds, attempts = db.execute("SELECT TOTAL(seconds), COUNT(*) FROM attempts").fetchone()
        last = db.execute("SELECT ended FROM attempts ORDER BY id DESC").fetchone()
        row = db.execute("SELECT stage, done, total, eta, best FROM progress").fetchone()
        best_so_far = None if row is None or row[4] is None else _best(row[4])
    stage, done, total, eta, _ = row or ("", 0.0, 1.0, None, None)
    ends = {"": "lost", "error": "failed", "finished": "finished"}
    ended = ends.get(last[0] if last else "stopped", "stopped")
    return RunStatus(
        state="running" if working else ended,
        stage=stage,
        share=done / total if total else 0.0,
        best=best_so_far,
        evaluations=evaluations,
        render_seconds=render_seconds,
        seconds=seconds,
        attempts=attempts,
        eta_seconds=eta if working else None,
        holder=working,
    )


class _Best(TypedDict):
    """The best design so far, see `RunStatus`."""

    level: str
    effort: NotRequired[str | None]
    objective: ObjectiveName
    value: float
    interval: Annotated[list[float], Field(min_length=2, max_length=2)] | None
    design: str


def _best(text: str) -> dict[str, Any]:
    try:
        best = TypeAdapter(_Best).validate_json(text)
    except ValidationError:
        raise sqlite3.DatabaseError("its best design cannot be read") from None
    level, effort = read_level(best["level"], best.get("effort"))
    return {**best, "level": level, "effort": effort}


def scaling_of(run: Path) -> dict[int, float]:
    """Return the least seconds that ``run`` would take so far, by number of workers.

    Renders take as long as they took and are shared evenly; no stage is shorter than its longest
    render, and every stage waits for the one before. Everything else takes as long as it took,
    trial renders too, which follow each other.
    """
    with writing(run), closing(open_record(run)) as db:
        stages = db.execute(
            "SELECT SUM(seconds), MAX(seconds), COUNT(DISTINCT worker) FROM evaluations WHERE id IN"
            " (SELECT MAX(id) FROM evaluations GROUP BY key) AND kind NOT LIKE '%/trial' "
            "GROUP BY kind"
        ).fetchall()
        (worked,) = db.execute("SELECT TOTAL(seconds) FROM attempts").fetchone()

    def rendering(workers: int | None = None) -> float:
        return float(
            sum(max(spent / (workers or made_by), longest) for spent, longest, made_by in stages)
        )

    serial = max(worked - rendering(), 0.0)
    return {workers: serial + rendering(workers) for workers in WORKERS}


SCALING_WORDS = (
    "At least: renders as long as they were, shared evenly, each stage waiting for its longest; "
    "other work does not shrink. With --hours, more workers render more in the same time instead."
)


def scaling_rows(seconds: dict[int, float]) -> list[tuple[str, str, str]]:
    """Return workers, time and how many times as fast, as text."""
    return [(str(n), duration(s), f"{seconds[1] / s:.2g}") for n, s in seconds.items()]
