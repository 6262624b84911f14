"""Where results go: a directory appears complete under its name, or not at all."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from render.errors import TactiluxError

MANIFEST = "result.json"


class OutputError(TactiluxError):
    """A place that results cannot, or must not, be written to."""


def check_target(target: Path) -> None:
    """Refuse a directory that holds anything but an earlier result, before any work is done.

    Raises:
        OutputError: ``target`` is a file, or a directory that this program did not write.
    """
    if not target.exists():
        nearest = next(parent for parent in target.absolute().parents if parent.exists())
        if not nearest.is_dir() or not os.access(nearest, os.W_OK):
            raise OutputError(
                f"{target} cannot be created because {nearest} is not a writable directory: "
                "choose another place with --out",
                field="out",
                value=str(target),
            )
        return
    if not target.is_dir():
        raise OutputError(
            f"{target} is not a directory: choose another place with --out",
            field="out",
            value=str(target),
        )
    if any(target.iterdir()) and not (target / MANIFEST).is_file():
        raise OutputError(
            f"{target} holds files but no earlier result ({MANIFEST}), so it is left alone: "
            "choose another place with --out",
            field="out",
            value=str(target),
        )


@contextmanager
def fresh_directory(target: Path) -> Iterator[Path]:
    """Give a temporary directory beside ``target`` that takes its place when the block succeeds.

    An earlier result is replaced by renames. What others put into it (a verification's checkpoint)
    is not listed in its manifest and moves over; after an error the earlier result still stands.
    """
    check_target(target)
    target.parent.mkdir(parents=True, exist_ok=True)
    work = Path(tempfile.mkdtemp(dir=target.parent, prefix=f".{target.name}."))
    try:
        yield work
        work.chmod(0o755)
        _swap(work, target)
    except BaseException:
        shutil.rmtree(work, ignore_errors=True)
        raise


def write_manifest(folder: Path, result: dict[str, object]) -> None:
    """Write ``result`` with the names of all files in ``folder``: what may be replaced later."""
    names = sorted({item.name for item in folder.iterdir()} | {MANIFEST})
    text = json.dumps({**result, "files": names}, indent=2, allow_nan=False) + "\n"
    (folder / MANIFEST).write_text(text, encoding="utf-8")


def write_atomically(path: Path, content: bytes) -> None:
    """Write one file: first beside its place, then renamed.

    Raises:
        OutputError: the place is not writable.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    except OSError as error:
        raise OutputError(
            f"{path} cannot be written ({error.strerror}): choose another place with --out",
            field="out",
            value=str(path),
        ) from None
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(content)
        Path(temporary).chmod(0o644)
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


def _swap(work: Path, target: Path) -> None:
    if not target.exists():
        os.rename(work, target)
        return
    own = _files(target)
    old = Path(tempfile.mkdtemp(dir=target.parent, prefix=f".{target.name}.")) / "old"
    os.rename(target, old)
    try:
        os.rename(work, target)
    except OSError:
        os.rename(old, target)
        raise
    for item in old.iterdir():
        if item.name not in own and not (target / item.name).exists():
            os.rename(item, target / item.name)
    shutil.rmtree(old.parent)


def _files(target: Path) -> set[str]:
    try:
        return set(json.loads((target / MANIFEST).read_text(encoding="utf-8"))["files"])
    except (OSError, ValueError, KeyError, TypeError):
        return set()
