"""A run directory: what can go wrong with it, one sentence each, and who works in it."""

from __future__ import annotations

import errno
import fcntl
import json
import os
import socket
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path

from render.errors import TactiluxError

RECORD = "run.sqlite"
"""The record of a run directory, see ``optimize.overnight.store``; without it there is no run."""


class RunError(TactiluxError):
    """A run directory that cannot be used as it was asked for."""


class RunInUseError(RunError):
    """Another process works in the run directory."""


_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
_CLOSED = {errno.EROFS, errno.EACCES, errno.EPERM}
_NO_ROOM = ("SQLITE_FULL", "SQLITE_IOERR")


@contextmanager
def writing(run: Path) -> Iterator[None]:
    """Turn what the operating system and SQLite say about ``run`` into one sentence.

    Raises:
        RunError: the disk is full, the directory read-only or gone, or the record damaged.
    """
    try:
        yield
    except OSError as error:
        if error.errno in _FULL:
            raise RunError(
                f"{run} cannot be written ({error.strerror}): free some space, then give the same "
                "command again; it goes on from what is finished",
                field="out",
                value=str(run),
            ) from error
        if error.errno in _CLOSED:
            raise RunError(
                f"{run} cannot be written ({error.strerror}): choose another place with --out",
                field="out",
                value=str(run),
            ) from error
        if error.errno == errno.ENOENT and not (run / RECORD).exists():
            raise _gone(run) from error
        raise
    except sqlite3.DatabaseError as error:
        # A record that the disk had no room for was never there; one that was, was taken away.
        full = getattr(error, "sqlite_errorname", "").startswith(_NO_ROOM) and run.is_dir()
        known = full or (run / RECORD).exists()
        raise (_of_sqlite(run, error) if known else _gone(run)) from error


def _gone(run: Path) -> RunError:
    return RunError(
        f"{run} was taken away while a night worked in it: put it back and give the same command "
        "again, or start anew in another place with --out",
        field="out",
        value=str(run),
    )


def _of_sqlite(run: Path, error: sqlite3.DatabaseError) -> RunError:
    name, message = getattr(error, "sqlite_errorname", ""), " ".join(str(error).split())
    if name.startswith(_NO_ROOM):
        advice = "free some space, then give the same command again; it goes on from what is done"
        return RunError(f"{run} cannot be written ({message}): {advice}", field="out")
    if name.startswith(("SQLITE_READONLY", "SQLITE_CANTOPEN", "SQLITE_PERM")):
        return RunError(
            f"{run} cannot be written ({message}): choose another place with --out", field="out"
        )
    return RunError(
        f"{run / RECORD} is damaged ({message}): restore it from a copy, or start anew in "
        "another place with --out; nothing was changed",
        field="run",
        value=str(run),
    )


LOCK = "lock"


@contextmanager
def locked(run: Path) -> Iterator[None]:
    """Hold ``run`` for this process; the lock ends with the process, however that ends.

    Raises:
        RunInUseError: names the process that holds it.
    """
    # Not opened for appending: who comes second must not touch what the first wrote.
    handle = os.open(run / LOCK, os.O_RDWR | os.O_CREAT, 0o644)
    with os.fdopen(handle, "r+", encoding="utf-8") as stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise _refusal(run, error) from None
        stream.truncate()
        started = datetime.now().astimezone().isoformat(timespec="seconds")
        owner = {"pid": os.getpid(), "host": socket.gethostname(), "started": started}
        stream.write(json.dumps(owner) + "\n")
        stream.flush()
        yield


def holder(run: Path) -> str | None:
    """Say who works in ``run``; None when nobody does. Nothing is written."""
    try:
        stream = (run / LOCK).open(encoding="utf-8")
    except OSError:
        return None
    with stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except OSError:
            return _described(stream.read())
    return None


def _refusal(run: Path, error: OSError) -> RunError:
    if error.errno not in (errno.EAGAIN, errno.EACCES):
        return RunError(
            f"{run / LOCK} cannot be locked ({error.strerror}), so two processes could disturb "
            "each other: choose a directory on another file system with --out",
            field="out",
            value=str(run),
        )
    name = _described((run / LOCK).read_text(encoding="utf-8"))
    return RunInUseError(
        f"{run} is in use by {name}: wait until it ends, or choose another directory with --out",
        field="out",
        value=str(run),
    )


def _described(text: str) -> str:
    try:
        owner = json.loads(text)
        return f"process {owner['pid']} on {owner['host']}, started {owner['started']}"
    except (ValueError, KeyError, TypeError):
        return "another process"
