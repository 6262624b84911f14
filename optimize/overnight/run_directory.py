"""A run directory: what can go wrong with it, one sentence each, and who works in it."""

from __future__ import annotations

import errno
import fcntl
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

from optimize.overnight.rows import connect
from optimize.ui.output import check_target
from render.errors import TactiluxError
from render.files import refuse_endless
from render.folders import foreign_names

RECORD, LOCK, LOG, REPORT = "run.sqlite", "lock", "log.txt", "report.html"
"""The record of a run directory, see ``optimize.overnight.store``; without it there is no run."""


class RunError(TactiluxError):
    """A run directory that cannot be used as it was asked for."""


def check_run_directory(run: Path) -> None:
    """Refuse a place that holds something else.

    Raises:
        OutputError: it is a file, or holds files but no record of a run.
    """
    # A process that ended before it had a record has left no more than these.
    if run.is_dir() and foreign_names(run) <= {LOCK, LOG}:
        return
    check_target(run, RECORD)


_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
_CLOSED = {errno.EROFS, errno.EACCES, errno.EPERM}


@contextmanager
def writing(run: Path) -> Iterator[None]:
    """Turn what the operating system and SQLite say about ``run`` into one sentence.

    Raises:
        RunError: the disk is full, the directory read-only or gone, or the record damaged.
    """
    try:
        yield
    except UnicodeDecodeError as error:  # in what SQLite says of names in a damaged record
        raise RunError(_damaged(run, "names in it are no text"), field="out") from error
    except (OSError, sqlite3.DatabaseError) as error:
        sentence = _sentence(run, error)
        if sentence is None:
            raise
        raise RunError(sentence, field="out") from error


def _sentence(run: Path, error: OSError | sqlite3.DatabaseError) -> str | None:
    if isinstance(error, OSError) and error.errno == errno.EINVAL and error.filename:
        return f"{error.filename}: {error.strerror}: take it away, or choose another directory"
    number, name = getattr(error, "errno", None), getattr(error, "sqlite_errorname", "")
    words = " ".join(str(getattr(error, "strerror", None) or error).split())
    gone, of_record = not (run / RECORD).exists(), isinstance(error, sqlite3.DatabaseError)
    # A record that the disk had no room for was never there; one that was, was taken away.
    no_room = name.startswith(("SQLITE_FULL", "SQLITE_IOERR")) and run.is_dir()
    if number in _FULL or no_room:
        return (
            f"{run} cannot be written ({words}): free some space, then give the same command "
            "again; it goes on from what is finished"
        )
    if gone and (of_record or number == errno.ENOENT):
        return (
            f"{run} was taken away while a night worked in it: put it back and give the same "
            "command again, or start anew in another place with --out"
        )
    closed = name.startswith(("SQLITE_READONLY", "SQLITE_CANTOPEN", "SQLITE_PERM"))
    if number in _CLOSED or closed:
        return f"{run} cannot be written ({words}): choose another place with --out"
    if of_record:
        return _damaged(run, words)
    return None


def _damaged(run: Path, why: str) -> str:
    return (
        f"{run / RECORD} is damaged ({why}): restore it from a copy, or start anew in another "
        "place with --out; nothing was changed"
    )


def open_record(run: Path) -> sqlite3.Connection:
    """Open the record for reading; on a read-only disk, without the files that WAL needs.

    Raises:
        RunError: there is none.
    """
    if not (run / RECORD).is_file():
        raise RunError(
            f"{run} holds no run ({RECORD}): name the directory given to tactilux overnight --out",
            field="run",
        )
    db = connect(run / RECORD, how="mode=ro")
    try:
        db.execute("SELECT 1 FROM sqlite_master").fetchone()
    except sqlite3.OperationalError:
        db.close()
        db = connect(run / RECORD, how="mode=ro&immutable=1")
    return db


@contextmanager
def locked(run: Path) -> Iterator[None]:
    """Hold ``run`` for this process; the lock ends with the process, however that ends.

    Raises:
        RunError: names the process that holds it.
    """
    if (run / LOCK).exists():
        refuse_endless(run / LOCK)
    with (run / LOCK).open("a", encoding="utf-8") as stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno not in (errno.EAGAIN, errno.EACCES):
                raise RunError(
                    f"{run / LOCK} cannot be locked ({error.strerror}), so two processes could "
                    "disturb each other: choose a directory on another file system with --out",
                    field="out",
                ) from None
            raise RunError(
                f"{run} is in use by {_last_attempt(run)}: wait until it ends, or choose another "
                "directory with --out",
                field="out",
            ) from None
        yield


def holder(run: Path) -> str | None:
    """Say who works in ``run``; None when nobody does. Nothing is written."""
    try:
        refuse_endless(run / LOCK)
        stream = (run / LOCK).open(encoding="utf-8")
    except OSError:
        return None
    with stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except OSError:
            return _last_attempt(run)
    return None


def _last_attempt(run: Path) -> str:
    """Return whose attempt began last, as a person may read it."""
    try:
        with closing(open_record(run)) as db:
            words = "SELECT pid, host, started FROM attempts ORDER BY id DESC"
            pid, host, started = db.execute(words).fetchone()
    except (RunError, sqlite3.Error, TypeError):
        return "another process"
    return f"process {pid} on {host}, started {started}"
