"""The run directory: an append-only record in SQLite and renders by the hash of their jobs.

``run.sqlite`` (WAL) holds

- ``meta``: schema, program version, scene hash and what was asked for;
- ``evaluations``: every render, with the SHA-256 of its file;
- ``decisions``: what was chosen on the way. A choice is logged before it is acted on, so that a
  run that was killed makes the same ones when it goes on, whatever its clock says then;
- ``attempts``: processes and the seconds each has worked, by monotonic clocks;
- ``progress``: one row for ``tactilux status``.

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

from optimize.overnight.run_directory import RECORD, RunError
from optimize.ui.provenance import program_version
from render.files import TEMPORARY, sync_folder, temporary_name, write_bytes
from render.progress import Progress
from render.reference import RenderJob, RenderResult
from render.scene import scene_of

SCHEMA = 5
RENDERS, STATES, TABLE = "renders", "states", "table"
HEARTBEAT = 2.0
"""Seconds between records of the time spent: what a killed process can lose of it."""
_TABLES = """
CREATE TABLE meta (name TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE evaluations (
    id INTEGER PRIMARY KEY, key TEXT NOT NULL, kind TEXT NOT NULL, level TEXT NOT NULL,
    seed INTEGER NOT NULL, spec TEXT NOT NULL, seconds REAL NOT NULL, sha256 TEXT NOT NULL,
    worker TEXT NOT NULL, time TEXT NOT NULL);
CREATE INDEX evaluation_key ON evaluations (key);
CREATE TABLE decisions (
    id INTEGER PRIMARY KEY, name TEXT NOT NULL UNIQUE, value TEXT NOT NULL, time TEXT NOT NULL);
CREATE TABLE attempts (
    id INTEGER PRIMARY KEY, pid INTEGER NOT NULL, host TEXT NOT NULL, started TEXT NOT NULL,
    seconds REAL NOT NULL, ended TEXT NOT NULL);
CREATE TABLE progress (
    id INTEGER PRIMARY KEY CHECK (id = 1), stage TEXT NOT NULL, done REAL NOT NULL,
    total REAL NOT NULL, eta REAL, best TEXT);
"""


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
        self._db = sqlite3.connect(run / RECORD, isolation_level=None)
        try:
            state = self._db.execute("PRAGMA quick_check(1)").fetchone()[0]
            if state != "ok":
                raise sqlite3.DatabaseError(state)
            check_request(run, self._db, request)
            _sweep(run)
            self._db.execute("PRAGMA journal_mode = WAL")
            self._db.execute("PRAGMA synchronous = FULL")
            for name in (RENDERS, STATES):
                (run / name).mkdir(exist_ok=True)
            (before,) = self._db.execute("SELECT TOTAL(seconds) FROM attempts").fetchone()
            self._before = float(before)
            self._attempt = self._db.execute(
                "INSERT INTO attempts (pid, host, started, seconds, ended) VALUES (?, ?, ?, 0, '')",
                (os.getpid(), socket.gethostname(), _now()),
            ).lastrowid
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
        words = "UPDATE attempts SET seconds = ?, ended = ? WHERE id = ?"
        self._db.execute(words, (self.spent() - self._before, ended, self._attempt))

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
        self._db.execute(
            "INSERT OR REPLACE INTO progress VALUES (1, ?, ?, ?, ?, ?)",
            (stage, at.done, at.total, at.eta_seconds, best and json.dumps(best)),
        )

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
        self._db.execute(
            "INSERT INTO decisions (name, value, time) VALUES (?, ?, ?)", (name, text, _now())
        )
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
        buffer = BytesIO()
        np.savez(buffer, estimate=result.estimate, largest=result.largest)
        content = buffer.getvalue()
        # Not made anew: a run directory that was taken away while a night works in it is told.
        os.stat(self.run / RENDERS)
        write_bytes(self.run / RENDERS / f"{job.key}.npz", content)
        spec = json.dumps(asdict(job) | {"scene": scene_of(job.scene).hash})
        digest = hashlib.sha256(content).hexdigest()
        self._db.execute(
            "INSERT INTO evaluations (key, kind, level, seed, spec, seconds, sha256, worker, time)"
            " VALUES (?, ?, 'reference', ?, ?, ?, ?, ?, ?)",
            (job.key, kind, job.seed, spec, result.seconds, digest, worker, _now()),
        )
        self.state(job).unlink(missing_ok=True)


def _create(run: Path, request: Request) -> None:
    """Write an empty record beside its place and rename it: no reader meets one without tables."""
    temporary = temporary_name(run / RECORD)
    meta = {"schema": SCHEMA, "tactilux": program_version(), "request": request}
    try:
        with closing(sqlite3.connect(temporary)) as db:
            db.executescript(_TABLES)
            rows = [(name, json.dumps(value)) for name, value in meta.items()]
            db.executemany("INSERT INTO meta VALUES (?, ?)", rows)
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
        rows = dict(db.execute("SELECT name, value FROM meta").fetchall())
    except sqlite3.OperationalError:
        raise RunError(
            f"{run / RECORD} is not the record of a run: choose another directory with --out",
            field="out",
        ) from None
    meta = {name: json.loads(value) for name, value in rows.items()}
    if meta.get("schema") != SCHEMA:
        raise RunError(
            f"{run} was written by tactilux {meta.get('tactilux')} in version "
            f"{meta.get('schema')} of the format, this program reads version {SCHEMA}: use that "
            "program, or choose another directory with --out",
            field="schema",
        )
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
    for folder in (run, run / RENDERS, run / STATES, run / TABLE, run / TABLE / "fit"):
        for item in folder.glob(".*"):
            if TEMPORARY.fullmatch(item.name):
                shutil.rmtree(item) if item.is_dir() else item.unlink()


def _plain(value: Any) -> Any:
    """Return what JSON can hold of an array or a dataclass."""
    return value.tolist() if isinstance(value, np.ndarray) else asdict(value)


def _now() -> str:
    return datetime.now().astimezone().isoformat(timespec="seconds")
