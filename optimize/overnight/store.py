"""The run directory: an append-only record in SQLite and renders by the hash of their jobs.

``run.sqlite`` (WAL) holds

- ``meta``: schema, program version, scene hash and what was asked for;
- ``evaluations``: every render, with the SHA-256 of its file;
- ``decisions``: what was chosen on the way. A choice is logged before it is acted on, so that a
  run that was killed makes the same ones when it goes on, whatever its clock says then;
- ``attempts``: processes and the seconds each has worked, by monotonic clocks;
- ``progress``: one row for ``tactilux status``.

Every row ends with its seal, the SHA-256 of what is before, and all are checked on opening.

``renders/<key>.npz`` are written beside their place, synced and renamed, then logged. Times of day
are there for people; nothing is decided by them.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import socket
import sqlite3
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import asdict
from datetime import datetime
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from optimize.design import RUN_MODEL
from optimize.overnight.rows import TABLES, check_kinds, check_rows, connect, write_row
from optimize.overnight.run_directory import RECORD, RunError
from optimize.ui.provenance import program_version
from render.files import (
    make_folder,
    npz_bytes,
    parse_json,
    sync_folder,
    temporary_name,
    write_bytes,
)
from render.folders import leftovers, put_back, remove_folder
from render.progress import Progress
from render.reference import RenderJob, RenderResult
from render.scene import scene_of
from surrogate.runtime.model_file import SUM_FILE

SCHEMA = 7
RENDERS, STATES, TABLE = "renders", "states", "table"
HEARTBEAT = 2.0
"""Seconds between records of the time spent: what a killed process can lose of it."""
Request = dict[str, str | int | None]
"""What a run directory is for, in words; for anything else asked for, another is needed."""


class Store:
    """An open run directory, see the module; only the holder of its lock may open it."""

    def __init__(self, run: Path, request: Request, note: Callable[[str], None]) -> None:
        """Open or begin the record of ``run``; ``note`` is told of damaged renders.

        Raises:
            RunError: the directory is for something else or of another version.
            sqlite3.DatabaseError: the record is damaged.
        """
        self.run, self.note = run, note
        self._began = self._beat = time.monotonic()
        if not (run / RECORD).exists():
            _create(run, request)
        # Autocommit: every statement is a transaction unless one is begun.
        self._db = connect(run / RECORD)
        try:
            check_request(run, self._db, request)
            _sweep(run)
            self._db.execute("PRAGMA journal_mode = WAL")
            self._db.execute("PRAGMA synchronous = FULL")
            for name in (RENDERS, STATES):
                make_folder(run / name)
            (before,) = self._db.execute("SELECT TOTAL(seconds) FROM attempts").fetchone()
            self._before = float(before)
            self._attempt = write_row(
                self._db, "attempts", pid=os.getpid(), host=socket.gethostname(), started=_now(),
                seconds=0.0, ended="",
            )  # fmt: skip
        except BaseException:
            self._db.close()
            raise

    def close(self, ended: str) -> None:
        """Record how this attempt ended, and close."""
        try:
            self._record_attempt(ended)
        finally:
            self._db.close()

    def _record_attempt(self, ended: str) -> None:
        spent = self.spent() - self._before
        write_row(self._db, "attempts", id=self._attempt, seconds=spent, ended=ended)

    def spent(self) -> float:
        """Return the seconds that all attempts together have worked."""
        return self._before + time.monotonic() - self._began

    def beat(self) -> None:
        """Record the time spent, at most every ``HEARTBEAT`` seconds."""
        if time.monotonic() - self._beat >= HEARTBEAT:
            self._beat = time.monotonic()
            self._record_attempt("")

    def progress(self, stage: str, at: Progress, best: dict[str, Any] | None) -> None:
        """Replace the row that ``tactilux status`` reads."""
        now = {"done": float(at.done), "total": float(at.total), "eta": at.eta_seconds}
        write_row(self._db, "progress", id=1, stage=stage, **now, best=best and json.dumps(best))

    def decided(self, name: str) -> Any:
        """Return the decision of that name, None where there is none yet."""
        row = self._db.execute("SELECT value FROM decisions WHERE name = ?", (name,)).fetchone()
        return None if row is None else json.loads(row[0])

    def decide(self, name: str, make: Callable[[], Any]) -> Any:
        """Return the logged decision, or log what ``make`` returns: JSON, dataclasses, arrays."""
        known = self.decided(name)
        if known is not None:
            return known
        text = json.dumps(make(), allow_nan=False, default=_plain)
        write_row(self._db, "decisions", name=name, value=text, time=_now())
        return json.loads(text)

    def state(self, job: RenderJob) -> Path:
        """Return where an unfinished render of ``job`` is kept."""
        return self.run / STATES / f"{job.key}.npz"

    def finished(self, job: RenderJob) -> RenderResult | None:
        """Return the render of ``job`` if it is logged and whole; a damaged one is told of.

        One whose process was killed before it was logged is rendered again, from its last state.
        """
        path = self.run / RENDERS / f"{job.key}.npz"
        row = self._db.execute(
            "SELECT sha256, seconds FROM evaluations WHERE key = ? ORDER BY id DESC", (job.key,)
        ).fetchone()
        if row is None:
            return None
        try:
            content = path.read_bytes()
        except FileNotFoundError:
            self.note(f"{path} is missing, though it was logged: it is rendered again")
            return None
        digest, seconds = row
        if hashlib.sha256(content).hexdigest() != digest:
            self.note(f"{path} is damaged (its SHA-256 is not the logged one): rendered again")
            return None
        # A process that was killed right after logging has left it.
        self.state(job).unlink(missing_ok=True)
        with np.load(BytesIO(content), allow_pickle=False) as arrays:
            return RenderResult(arrays["estimate"], arrays["largest"], float(seconds))

    def keep(self, job: RenderJob, result: RenderResult, kind: str, worker: str) -> None:
        """Write the render of ``job``, then log it; the same result makes the same bytes."""
        content = npz_bytes({"estimate": result.estimate, "largest": result.largest})
        # Not made anew: a run directory that was taken away while a night works in it is told.
        os.stat(self.run / RENDERS)
        write_bytes(self.run / RENDERS / f"{job.key}.npz", content)
        spec = json.dumps(asdict(job) | {"scene": scene_of(job.scene).hash})
        about = {"key": job.key, "kind": kind, "level": "reference", "seed": job.seed, "spec": spec}
        write_row(
            self._db, "evaluations", **about, seconds=float(result.seconds),
            sha256=hashlib.sha256(content).hexdigest(), worker=worker, time=_now(),
        )  # fmt: skip
        self.state(job).unlink(missing_ok=True)


def _create(run: Path, request: Request) -> None:
    """Write an empty record beside its place and rename it: no reader meets one without tables."""
    temporary = temporary_name(run / RECORD)
    meta = {"schema": SCHEMA, "tactilux": program_version(), "request": request}
    try:
        with closing(connect(temporary)) as db:
            db.executescript(f"BEGIN; {TABLES}")
            for name, value in meta.items():
                write_row(db, "meta", name=name, value=json.dumps(value))
            db.commit()
        os.replace(temporary, run / RECORD)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    sync_folder(run)


def check_request(run: Path, db: sqlite3.Connection, wanted: Request | None) -> None:
    """Refuse a record of another version or another request; ``wanted`` None takes any request.

    Raises:
        RunError: says which it is.
    """
    try:
        check_kinds(db)
        rows = dict(db.execute("SELECT name, value FROM meta LIMIT 99").fetchall())
        meta = {name: parse_json(value) for name, value in rows.items()}
    except sqlite3.OperationalError:
        raise RunError(
            f"{run / RECORD} is not the record of a run: choose another directory with --out",
            field="out",
        ) from None
    except (ValueError, TypeError):  # of no JSON, and of what is no text
        raise sqlite3.DatabaseError("what it says of itself cannot be read") from None
    if meta.get("schema") != SCHEMA:
        raise RunError(
            f"{run} was written by tactilux {meta.get('tactilux')} in version "
            f"{meta.get('schema')} of the format, this program reads version {SCHEMA}: use that "
            "program, or choose another directory with --out",
            field="schema",
        )
    check_rows(db)
    if wanted is None:
        return
    for name, value in wanted.items():
        there = meta["request"].get(name)
        if there != value:
            raise RunError(
                f"{run} is a run {_asked(name, there)}, asked for is one {_asked(name, value)}: "
                "choose another directory with --out, or ask for the same again",
                field=name,
            )


def _asked(name: str, value: object) -> str:
    return f"without {name}" if value is None else f"with {name} {value}"


def _sweep(run: Path) -> None:
    """Take away what a killed process had not finished writing."""
    put_back(run / RUN_MODEL, SUM_FILE, lambda old: remove_folder(old, SUM_FILE))
    for folder in (run, run / RENDERS, run / STATES, run / TABLE, run / TABLE / "fit"):
        for item in leftovers(folder):
            shutil.rmtree(item) if item.is_dir() else item.unlink()


def _plain(value: Any) -> Any:
    """Return what JSON can hold of an array or a dataclass."""
    return value.tolist() if isinstance(value, np.ndarray) else asdict(value)


def _now() -> str:
    return datetime.now().astimezone().isoformat(timespec="seconds")
