"""What is known of a run, also while another process works in it; nothing is written."""

from __future__ import annotations

import json
import sqlite3
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from optimize.overnight.run_directory import RunError, holder, writing
from optimize.overnight.store import RECORD, check_request


@dataclass(frozen=True)
class RunStatus:
    """How far a run is.

    Arguments:
        state: ``running``, ``finished``, ``stopped`` (goes on when asked) or ``lost`` (its process
            was killed; goes on when asked as well).
        stage: what it does, or did last; share: how much of that is done, 0 to 1.
        best: ``score``, ``interval``, ``level`` and ``design`` of the best design so far.
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

    def to_json(self) -> dict[str, Any]:
        """Return what programs rely on."""
        return asdict(self)


def status_of(run: Path) -> RunStatus:
    """Return how far the run in ``run`` is.

    Raises:
        RunError: there is no run, it is of another version, or damaged.
    """
    if not (run / RECORD).is_file():
        raise RunError(
            f"{run} holds no run ({RECORD}): name the directory given to tactilux overnight --out",
            field="run",
            value=str(run),
        )
    working = holder(run)
    with writing(run):
        db = _opened(run)
        try:
            check_request(run, db, None)
            return _read(db, working)
        finally:
            db.close()


def _opened(run: Path) -> sqlite3.Connection:
    """Open the record for reading; on a read-only disk, without the files that WAL needs."""
    path = (run / RECORD).absolute().as_uri()
    try:
        db = sqlite3.connect(f"{path}?mode=ro", uri=True)
        db.execute("SELECT 1 FROM sqlite_master").fetchone()
    except sqlite3.OperationalError:
        db = sqlite3.connect(f"{path}?mode=ro&immutable=1", uri=True)
    return db


def _read(db: sqlite3.Connection, working: str | None) -> RunStatus:
    (evaluations, render_seconds) = db.execute(
        "SELECT COUNT(DISTINCT key), TOTAL(seconds) FROM evaluations"
    ).fetchone()
    (seconds, attempts) = db.execute("SELECT TOTAL(seconds), COUNT(*) FROM attempts").fetchone()
    last = db.execute("SELECT ended FROM attempts ORDER BY id DESC").fetchone()
    row = db.execute("SELECT stage, done, total, eta, best FROM progress").fetchone()
    stage, done, total, eta, best = row or ("", 0.0, 1.0, None, None)
    ended = {"": "lost", "finished": "finished"}.get(last[0] if last else "stopped", "stopped")
    return RunStatus(
        state="running" if working else ended,
        stage=stage,
        share=done / total if total else 0.0,
        best=None if best is None else json.loads(best),
        evaluations=evaluations,
        render_seconds=render_seconds,
        seconds=seconds,
        attempts=attempts,
        eta_seconds=eta if working else None,
        holder=working,
    )
