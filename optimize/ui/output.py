"""Where results go: a directory appears complete under its name, or not at all."""

from __future__ import annotations

import hashlib
import itertools
import os
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

from optimize.ui.console import note
from optimize.ui.process import OutputError
from render.files import can_create, read_json, sync_folder, write_bytes, write_json
from render.folders import foreign_names, fresh_folder, put_back, remove_folder, replace_folder

MANIFEST = "result.json"
DESIGN_KEYS = ("scene_hash", "angles_deg", "power")
"""What makes two design files one design; the rest is who rated it, and how."""


def check_target(target: Path, mark: str = MANIFEST) -> None:
    """Refuse a directory that holds anything but an earlier result, before any work is done.

    ``mark`` is the file by which an earlier result is known.

    Raises:
        OutputError: ``target`` is a file, or a directory that this program did not write, or that
            has no name of its own and cannot be replaced.
    """
    if mark == MANIFEST and target.name in ("", ".."):
        raise OutputError(
            f"{target} is a directory that cannot be replaced from within: name another place "
            "with --out",
            field="out",
        )
    check_folder(target)
    if target.exists() and foreign_names(target) and not (target / mark).is_file():
        raise OutputError(
            f"{target} holds files but no earlier result ({mark}), so it is left alone: "
            "choose another place with --out",
            field="out",
        )


def check_folder(target: Path) -> None:
    """Refuse a name that no directory can have, before any work is done.

    Raises:
        OutputError: ``target`` is a file, or cannot be created.
    """
    if not target.exists():
        _check_place(target)
    elif not target.is_dir():
        raise OutputError(
            f"{target} is not a directory: choose another place with --out", field="out"
        )


@contextmanager
def fresh_directory(target: Path, keep: str = "") -> Iterator[Path]:
    """Give a temporary directory beside ``target`` that takes its place when the block succeeds.

    An earlier result is replaced by renames. What others put into it (a verification's checkpoint)
    is not listed in its manifest and moves over; after an error the earlier result still stands.

    Where the earlier result holds another design in its file ``keep``, it is kept with everything
    in it, beside ``target`` under the first free number.
    """

    def settle(old: Path) -> None:
        _settle(old, target, keep)

    with ExitStack() as stack:
        check_target(target)
        with writable(target):
            put_back(target, MANIFEST, settle)
            work = stack.enter_context(fresh_folder(target))
        yield work
        replace_folder(work, target, settle)


def write_manifest(folder: Path, result: dict[str, object]) -> None:
    """Write ``result`` with the names and SHA-256 of all files in ``folder``, to be replaced."""
    items = sorted(folder.iterdir())
    sums = {item.name: hashlib.sha256(item.read_bytes()).hexdigest()
            for item in items if item.is_file()}  # fmt: skip
    names = sorted({item.name for item in items} | {MANIFEST})
    write_json(folder / MANIFEST, {**result, "files": names, "sums": sums}, indent=2)


def check_file(path: Path, kinds: Sequence[str] = ()) -> None:
    """Refuse a name that no file can have, before any work is done.

    ``kinds`` are endings of names, where they say what is written.

    Raises:
        OutputError: ``path`` is a directory, has another ending, or nothing can be written there.
    """
    if path.is_dir():
        raise OutputError(f"{path} is a directory: name a file with --out", field="out")
    if kinds and path.suffix.lower() not in kinds:
        raise OutputError(
            f"{path} does not end with a kind of file, allowed: {', '.join(kinds)}", field="out"
        )
    if not path.exists():
        _check_place(path)


def _check_place(path: Path) -> None:
    if not can_create(path):
        raise OutputError(
            f"{path} cannot be created, its place is not a writable directory: choose another "
            "place with --out",
            field="out",
        )


@contextmanager
def writable(path: Path) -> Iterator[None]:
    """Raise one OutputError where ``path``, which the user named, cannot be written."""
    try:
        yield
    except OSError as error:
        raise OutputError(
            f"{path} cannot be written ({error.strerror}): choose another place with --out",
            field="out",
        ) from None


def write_result(path: Path, content: bytes) -> None:
    """Write one file that the user named; see `writable`."""
    with writable(path):
        write_bytes(path, content)


def design_in(path: Path) -> dict[str, object]:
    """Return what makes the design in a file one design; nothing where there is none."""
    content = read_json(path)
    return {key: content.get(key) for key in DESIGN_KEYS} if content else {}


def _differ(earlier: Path, later: Path) -> bool:
    """Return whether two design files hold different designs, or designs of different scenes."""
    first = design_in(earlier)
    return bool(first) and first != design_in(later)


def _free_name(target: Path) -> Path:
    numbered = (target.with_name(f"{target.name}-{number}") for number in itertools.count(1))
    return next(path for path in numbered if not path.exists())


def _settle(old: Path, target: Path, keep: str) -> None:
    """Take an earlier result away, after what others have put into it."""
    if keep and _differ(old / keep, target / keep):
        aside = _free_name(target)
        os.rename(old, aside)
        note(f"The earlier result, another design, is kept in {aside}")
        return
    own = _files(old)
    for item in old.iterdir():
        if item.name not in own and not (target / item.name).exists():
            os.rename(item, target / item.name)
    # They have their new names for good before they lose the old ones.
    sync_folder(target)
    remove_folder(old, MANIFEST)


def _files(target: Path) -> set[str]:
    names = read_json(target / MANIFEST).get("files", ())
    return {name for name in names if isinstance(name, str)} if isinstance(names, list) else set()
