"""Files that appear complete under their name, and arrays read without ever unpickling.

The only place where results, plans, checkpoints and caches are written.
"""

from __future__ import annotations

import errno
import json
import os
import re
import stat
import sys
import tempfile
import tomllib
import uuid
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from render.errors import ReadError, TableError

TEMPORARY = re.compile(r"\..+\.[0-9a-f]{32}")
"""Names of files and folders that are not finished; a killed process leaves them behind."""
SHORTAGES = (errno.EMFILE, errno.ENFILE, errno.ENOMEM)
"""Of handles and memory, which other programs take."""
DAMAGE = (
    ValueError, EOFError, KeyError, RuntimeError, SyntaxError, OverflowError, zipfile.BadZipFile,
    zlib.error,
)  # fmt: skip
"""What damaged or forged archives raise, from an unknown compression to an absurd header."""
DAMAGED = "it is damaged, or holds no arrays"


@contextmanager
def replacing(path: Path) -> Iterator[BinaryIO]:
    """Give a stream whose content takes the place of ``path`` when the block succeeds.

    A temporary file in the same folder is written, synced and renamed, and the folder is synced:
    a reader, or a machine that lost its power, meets the old file or the new one, never half of it.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    # Not mkstemp, whose files only their owner may read.
    temporary = temporary_name(path)
    try:
        with temporary.open("xb") as stream:
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(temporary, path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    sync_folder(path.parent)


def write_bytes(path: Path, content: bytes) -> None:
    """Write ``content`` to ``path``, as `replacing` does."""
    with replacing(path) as stream:
        stream.write(content)


def write_text(path: Path, text: str) -> None:
    """Write ``text`` as UTF-8 to ``path``, as `replacing` does."""
    write_bytes(path, text.encode("utf-8"))


def write_json(path: Path, content: Mapping[str, Any], indent: int | None = None) -> None:
    """Write ``content`` as JSON, without NaN, to ``path``, as `replacing` does."""
    write_text(path, json.dumps(content, indent=indent, allow_nan=False) + "\n")


def write_npz(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Write ``arrays`` to ``path``, as `replacing` does; the same arrays make the same bytes."""
    with replacing(path) as stream:
        np.savez(stream, **arrays)  # type: ignore[arg-type]


def can_create(path: Path) -> bool:
    """Return whether ``path`` can be made: whether the nearest folder that is there takes one.

    It is tried, since folders of the system that are no place for files give all rights to some.
    """
    nearest = next(parent for parent in path.absolute().parents if parent.exists())
    try:
        os.rmdir(tempfile.mkdtemp(prefix=".", dir=nearest))
    except OSError:
        return False
    return True


def replace_folder(fresh: Path, target: Path) -> Path | None:
    """Put the folder ``fresh``, which lies beside it, in the place of ``target``.

    Return where an earlier ``target`` lies now, None without one; when an error comes between, it
    is back in its place.
    """
    old = temporary_name(target) if target.exists() else None
    if old is not None:
        os.rename(target, old)
    try:
        os.rename(fresh, target)
    except OSError:
        if old is not None:
            os.rename(old, target)
        raise
    sync_folder(target.parent)
    return old


def temporary_name(path: Path) -> Path:
    """Return a new name beside ``path`` of the form `TEMPORARY`."""
    return path.with_name(f".{path.name}.{uuid.uuid4().hex}")


def sync_folder(folder: Path) -> None:
    """Make the names in ``folder`` outlast a loss of power."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def read_bytes(path: Path) -> bytes:
    """Return the content of a file that somebody named.

    Raises:
        OSError: it cannot be read, or is a device, of which there may be no end.
    """
    refuse_device(path)
    return path.read_bytes()


def refuse_device(path: Path) -> None:
    """Raise the OSError of a device: some never end, and would be read until memory is full.

    Pipes pass, as shells make them for ``tactilux describe <(...)``.
    """
    mode = os.stat(path).st_mode
    if stat.S_ISCHR(mode) or stat.S_ISBLK(mode):
        raise OSError(errno.EINVAL, "it is a device, no file", str(path))


def read_text(path: Path) -> str:
    """Return the text of a file that a person wrote.

    Raises:
        ValueError: a phrase that says why there is none: no such file, a folder, not UTF-8.
    """
    try:
        # Editors on Windows put a mark in front, and end lines in their own way.
        text = read_bytes(path).decode("utf-8-sig")
        return text.replace("\r\n", "\n").replace("\r", "\n")
    except OSError as error:
        raise ValueError(f"cannot be read: {error.strerror}") from error
    except UnicodeDecodeError:
        raise ValueError("is not text in UTF-8") from None
    except ValueError:
        raise ValueError("cannot be read: no file can have this name") from None


def parse_toml(text: str) -> dict[str, Any]:
    """Return the content of a TOML file.

    Raises:
        ValueError: what is wrong, and where.
    """
    with _told_in_words():
        return tomllib.loads(text)


def parse_json(text: str) -> Any:
    """Return the content of a JSON file.

    Raises:
        ValueError: what is wrong, and where.
    """
    with _told_in_words():
        return json.loads(text)


@contextmanager
def _told_in_words() -> Iterator[None]:
    """Say of depth and digits, which Python's own limits stop, what is wrong with the file."""
    try:
        yield
    except RecursionError:
        raise ValueError("its lists are too deep in each other") from None
    except json.JSONDecodeError:
        raise
    except tomllib.TOMLDecodeError as error:
        # Keys with dots are tuples to it: ('pad', 'width').
        keys = re.compile(r"\(('[^']*'(?:, '[^']*')*),?\)")
        words = keys.sub(lambda key: ".".join(re.findall(r"'([^']*)'", key[1])), str(error))
        raise ValueError(words) from None
    except ValueError:
        digits = sys.get_int_max_str_digits()
        raise ValueError(f"it has a number of more than {digits} digits") from None


def read_json(path: Path) -> dict[str, Any]:
    """Return the object in ``path``; nothing when there is none or it is damaged."""
    try:
        content = parse_json(read_bytes(path).decode("utf-8"))
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}


def read_npz(path: Path) -> dict[str, np.ndarray]:
    """Return all arrays of an ``.npz`` file.

    Raises:
        TableError: when the file is missing, damaged, or holds anything but plain arrays.
        ReadError: when it may well be whole, and memory, handles or rights do not suffice to read
            it.
    """
    try:
        refuse_device(path)
        # Opened as a zip first: numpy would take other files for a pickle or a single array.
        with zipfile.ZipFile(path) as archive:
            foreign = [name for name in archive.namelist() if not name.endswith(".npy")]
        if foreign:
            raise TableError(f"{path} holds more than arrays: {foreign[0]!r}", field="table")
        with np.load(path, allow_pickle=False) as stored:
            return {name: np.asarray(stored[name]) for name in stored.files}
    except FileNotFoundError:
        raise TableError(f"{path} does not exist", field="table") from None
    except OSError as error:
        # Damage leads to places before the beginning (EINVAL), or comes without a number.
        if error.errno not in (None, errno.EINVAL):
            raise _unread(path, error) from None
        why = error.strerror or DAMAGED
    except MemoryError as error:
        # Of a large array, or of a damaged header that speaks of one.
        if _may_be_whole(path):
            raise _unread(path, error) from None
        why = DAMAGED
    except DAMAGE:
        why = DAMAGED
    raise TableError(f"{path} is not a readable .npz file: {why}", field="table")


def _unread(path: Path, error: OSError | MemoryError) -> ReadError:
    why, step = "there is not enough memory", "close other programs and try again"
    if isinstance(error, OSError):
        why = str(error.strerror)
        step = step if error.errno in SHORTAGES else "mend that and try again"
    return ReadError(f"{path} cannot be read, and is left as it is: {why}; {step}", field="table")


def _may_be_whole(path: Path) -> bool:
    """Return whether nothing shows that a file is damaged; it is read piece by piece."""
    try:
        with zipfile.ZipFile(path) as archive:
            return archive.testzip() is None
    except (OSError, MemoryError):
        return True
    except DAMAGE:
        return False


def read_or_drop(path: Path, *names: str) -> dict[str, np.ndarray] | None:
    """Return the arrays of a file that an earlier call kept, None without one.

    A file that is damaged, or lacks one of ``names``, is taken away, so that it is made again.

    Raises:
        ReadError: it cannot be read just now, and stays: it may be the work of hours.
    """
    if not path.exists():
        return None
    try:
        arrays = read_npz(path)
    except TableError:
        arrays = {}
    if arrays and arrays.keys() >= set(names):
        return arrays
    # Another process may have taken it away already.
    path.unlink(missing_ok=True)
    return None
