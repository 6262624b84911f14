"""What can go wrong with a run directory, one sentence each; nothing in it is destroyed."""

from __future__ import annotations

import errno
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
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
        raise (_of_sqlite(run, error) if (run / RECORD).exists() else _gone(run)) from error


def _gone(run: Path) -> RunError:
    return RunError(
        f"{run} was taken away while a night worked in it: put it back and give the same command "
        "again, or start anew in another place with --out",
        field="out",
        value=str(run),
    )


def _of_sqlite(run: Path, error: sqlite3.DatabaseError) -> RunError:
    name, said = getattr(error, "sqlite_errorname", ""), " ".join(str(error).split())
    if name.startswith(("SQLITE_FULL", "SQLITE_IOERR")):
        advice = "free some space, then give the same command again; it goes on from what is done"
        return RunError(f"{run} cannot be written ({said}): {advice}", field="out")
    if name.startswith(("SQLITE_READONLY", "SQLITE_CANTOPEN", "SQLITE_PERM")):
        return RunError(
            f"{run} cannot be written ({said}): choose another place with --out", field="out"
        )
    return RunError(
        f"{run / RECORD} is damaged ({said}): restore it from a copy, or start anew in "
        "another place with --out; nothing was changed",
        field="run",
        value=str(run),
    )
