"""Folders that appear complete under their name, and take the place of an earlier one.

A folder is put together beside its place under a name of the form `TEMPORARY` and renamed. It is
*whole* once it has its manifest, a file that is written last and removed first. A process that is
killed at any instant leaves whole folders and pieces of others; `put_back` gives the former their
place again and takes the latter away. Whoever writes into a folder holds its lock, which ends with
the process.
"""

from __future__ import annotations

import fcntl
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from render.files import TEMPORARY, make_folder, sync_folder, temporary_name


@contextmanager
def fresh_folder(target: Path) -> Iterator[Path]:
    """Give a new folder beside ``target`` that is taken away after the block, if still there."""
    make_folder(target.parent)
    fresh = temporary_name(target)
    with ExitStack() as stack:
        # Before it is locked, `put_back` of another process would take it for a leftover.
        with _held(target.parent):
            fresh.mkdir()
            stack.callback(shutil.rmtree, fresh, ignore_errors=True)
            stack.enter_context(_held(fresh))
        yield fresh


Settle = Callable[[Path], None]
"""Takes a whole folder away that another one has replaced, after what is to be kept of it."""


def replace_folder(fresh: Path, target: Path, settle: Settle) -> None:
    """Put the folder ``fresh``, which lies beside it, in the place of ``target``.

    ``settle`` is given an earlier one; when an error comes between, it is back in its place.
    """
    with _held(target.parent):
        old = temporary_name(target) if target.exists() else None
        if old is not None:
            os.rename(target, old)
            # A loss of power may not keep the next rename without this one: ``old`` had no name.
            sync_folder(target.parent)
        try:
            os.rename(fresh, target)
        except OSError:
            if old is not None:
                os.rename(old, target)
            raise
        sync_folder(target.parent)
        if old is not None:
            settle(old)


def remove_folder(folder: Path, manifest: str) -> None:
    """Take a folder away, the manifest first: what a killed process leaves of it is not whole."""
    (folder / manifest).unlink(missing_ok=True)
    sync_folder(folder)
    shutil.rmtree(folder)


def put_back(target: Path, manifest: str, settle: Settle) -> None:
    """Mend what killed processes have left of replacing ``target``.

    The latest whole folder takes the place of a missing ``target``; ``settle`` is given every other
    one. Pieces that nobody works in are taken away.
    """
    if not target.parent.is_dir():
        return
    with _held(target.parent):
        idle = [path for path in leftovers(target.parent)
                if became(path.name) == target.name and path.is_dir() and not is_busy(path)
                ]  # fmt: skip
        whole = [path for path in idle if (path / manifest).is_file()]
        whole.sort(key=lambda path: (path / manifest).stat().st_mtime)
        for path in set(idle) - set(whole):
            shutil.rmtree(path, ignore_errors=True)
        if whole and not target.exists():
            os.rename(whole.pop(), target)
            sync_folder(target.parent)
        for path in whole:
            settle(path)


def leftovers(folder: Path) -> list[Path]:
    """Return what processes have not finished in ``folder``, or are just now working on."""
    with suppress(FileNotFoundError):
        return [path for path in folder.iterdir() if TEMPORARY.fullmatch(path.name)]
    return []


def foreign_names(folder: Path) -> set[str]:
    """Return the names of all that is in ``folder`` but `leftovers`."""
    return {path.name for path in folder.iterdir() if not TEMPORARY.fullmatch(path.name)}


def became(name: str) -> str:
    """Return what a leftover of that name was to become.

    >>> became(".finger20.0123456789abcdef0123456789abcdef")
    'finger20'
    """
    found = TEMPORARY.fullmatch(name)
    return found[1] if found else ""


@contextmanager
def _held(folder: Path) -> Iterator[None]:
    """Hold the lock of a folder; where there are none, as on some networks, all are busy."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


def is_busy(folder: Path) -> bool:
    """Return whether a process holds the lock of a folder."""
    handle = os.open(folder, os.O_RDONLY | os.O_NONBLOCK)
    try:
        fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:
        return True
    finally:
        os.close(handle)
    return False
