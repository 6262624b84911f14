"""Rows of a record with their seals: what a disk has turned in them, or a stranger, is not read."""

from __future__ import annotations

import hashlib
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any

from render.files import refuse_endless

COLUMNS = {
    "meta": "id INTEGER PRIMARY KEY, name TEXT NOT NULL UNIQUE, value TEXT NOT NULL",
    "evaluations": "id INTEGER PRIMARY KEY, key TEXT NOT NULL, kind TEXT NOT NULL, "
    "level TEXT NOT NULL, seed INTEGER NOT NULL, spec TEXT NOT NULL, seconds REAL NOT NULL, "
    "sha256 TEXT NOT NULL, worker TEXT NOT NULL, time TEXT NOT NULL",
    "decisions": "id INTEGER PRIMARY KEY, name TEXT NOT NULL UNIQUE, value TEXT NOT NULL, "
    "time TEXT NOT NULL",
    "attempts": "id INTEGER PRIMARY KEY, pid INTEGER NOT NULL, host TEXT NOT NULL, "
    "started TEXT NOT NULL, seconds REAL NOT NULL, ended TEXT NOT NULL",
    "progress": "id INTEGER PRIMARY KEY CHECK (id = 1), stage TEXT NOT NULL, done REAL NOT NULL, "
    "total REAL NOT NULL, eta REAL, best TEXT",
}
TABLES = "".join(
    f"CREATE TABLE {name} ({columns}, seal TEXT NOT NULL) STRICT;\n"
    for name, columns in COLUMNS.items()
) + "CREATE INDEX evaluation_key ON evaluations (key);\n"  # fmt: skip
_NAMES = {
    table: [part.split()[0] for part in columns.split(", ")] for table, columns in COLUMNS.items()
}
_SEALS = {table: f"seal_of({', '.join(names)})" for table, names in _NAMES.items()}


def connect(path: Path, *, how: str = "") -> sqlite3.Connection:
    """Open a record; ``how`` are parameters of its URI, such as ``mode=ro``.

    Every statement is a transaction unless one is begun.

    Raises:
        OSError: it is no file, or one of those beside it is none.
    """
    for end in ("", "-wal", "-shm", "-journal"):
        beside = path.with_name(path.name + end)
        if beside.exists():
            refuse_endless(beside)
    db = sqlite3.connect(f"{path.absolute().as_uri()}?{how}", uri=True, isolation_level=None)
    db.create_function("seal_of", -1, _seal_of, deterministic=True)
    return db


def write_row(db: sqlite3.Connection, table: str, **values: Any) -> int:
    """Write a row of ``table``, a new one or what has changed of that with an ``id``, and seal it.

    Return its ``id``.
    """
    row, rest = values.pop("id", None), (*values.values(),)
    with _together(db):
        changes = ", ".join(f"{name} = ?" for name in values)
        done = db.execute(f"UPDATE {table} SET {changes} WHERE id = ?", (*rest, row))
        if done.rowcount == 0:
            words = f"INSERT INTO {table} (id, {', '.join(values)}, seal) VALUES "
            done = db.execute(f"{words} (?, {'?, ' * len(values)} '')", (row, *rest))
            row = done.lastrowid
        db.execute(f"UPDATE {table} SET seal = {_SEALS[table]} WHERE id = ?", (row,))
    assert row is not None
    return int(row)


@contextmanager
def _together(db: sqlite3.Connection) -> Iterator[None]:
    """Make what is written in the block one transaction, or a part of the one that is open."""
    db.execute("SAVEPOINT row")
    try:
        yield
    except BaseException:
        with suppress(sqlite3.Error):  # a full disk may have ended the transaction already
            db.execute("ROLLBACK TO row")
            db.execute("RELEASE row")
        raise
    db.execute("RELEASE row")


def check_kinds(db: sqlite3.Connection) -> None:
    """Refuse a record that holds more than tables: a view in the place of one may never end.

    Raises:
        sqlite3.DatabaseError: names it.
    """
    words = "type NOT IN ('table', 'index') OR sql LIKE 'CREATE VIRTUAL%'"
    other = db.execute(f"SELECT type, name FROM sqlite_master WHERE {words} LIMIT 1").fetchone()
    if other is not None:
        raise sqlite3.DatabaseError(f"it holds the {other[0]} {other[1]}")


def check_rows(db: sqlite3.Connection) -> None:
    """Refuse a record that has other tables than `TABLES`, or a row without its seal.

    Raises:
        sqlite3.DatabaseError: says which.
    """
    with closing(sqlite3.connect(":memory:")) as wanted:
        wanted.executescript(TABLES)
        if _layout(db) != _layout(wanted):
            raise sqlite3.DatabaseError("its tables are not those of a record")
    state = db.execute("PRAGMA integrity_check(1)").fetchone()[0]
    if state != "ok":
        raise sqlite3.DatabaseError(state)
    for table, seal in _SEALS.items():
        bad = db.execute(f"SELECT id FROM {table} WHERE seal IS NOT {seal}").fetchone()
        if bad is not None:
            raise sqlite3.DatabaseError(f"row {bad[0]} of {table} is not as it was written")


def _layout(db: sqlite3.Connection) -> list[tuple[str, str, str | None]]:
    words = "SELECT type, name, sql FROM sqlite_master ORDER BY name LIMIT 99"
    return db.execute(words).fetchall()


def _seal_of(*values: Any) -> str:
    return hashlib.sha256(repr(values).encode()).hexdigest()
