"""One process per run directory: the second refuses and names the first."""

from __future__ import annotations

import errno
import fcntl
import json
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path

from optimize.overnight.errors import RunError, RunInUseError

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
