"""Files that appear complete under their name, and arrays read without ever unpickling.

The only place where results, plans, checkpoints and caches are written. What the program reads
again is sealed: archives and JSON end with the SHA-256 of all that is before, so that no bit that
a disk has turned is read. Files without a seal are of an earlier version, or of other programs.
"""

from __future__ import annotations

import errno
import hashlib
import json
import math
import os
import re
import stat
import struct
import sys
import tomllib
import uuid
import zipfile
import zlib
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from render.errors import ReadError, TableError

TEMPORARY = re.compile(r"\.(.+)\.[0-9a-f]{32}(-journal|-wal|-shm)?")
"""Names of files and folders that are not finished; a killed process leaves them behind.

They begin with what is to become of them, and databases have files beside them.
"""
LARGEST = 1 << 30
"""Bytes of a file that is read as a whole, at most."""
SEAL = re.compile(rb'"seal": "([0-9a-f]{64})"\}\s*\Z')
SEALED = re.compile(rb'"seal"|[0-9a-f]{64}"\}\s*\Z')
"""What shows of a seal at the end of a JSON file, whichever of its bits is turned."""
SEAL_OF_ARCHIVE = b"sha256 "
"""Begin of an archive's seal; its length shows too where one bit of it is turned."""
MEGABYTE = 1_000_000
MOST_TEXT = 4 * MEGABYTE
"""Bytes of a text that a person wrote; scenes have some thousand."""
MOST_DEPTH = 50
"""How deep tables and lists may lie in each other: recursion over them has an end."""
MOST_UNPACKED, MOST_SHRUNK = 256 * MEGABYTE, 20
"""Bytes that any archive may unpack to, and how many times its own size a larger one may: numbers
shrink little, and nothing else is kept."""
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

    What could not be read again is not written: an OSError says that it is larger than `LARGEST`.
    A temporary file in the same folder is written, synced and renamed, and the folder is synced:
    a reader, or a machine that lost its power, meets the old file or the new one, never half of it.
    """
    make_folder(path.parent)
    # Not mkstemp, whose files only their owner may read.
    temporary = temporary_name(path)
    try:
        with temporary.open("x+b") as stream:
            yield stream
            if stream.seek(0, os.SEEK_END) > LARGEST:
                raise _too_large(path, f"{stream.tell():,}", LARGEST)
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
    """Write ``content`` as sealed JSON, without NaN, to ``path``, as `replacing` does."""
    text = json.dumps(content, indent=indent, allow_nan=False)
    text = text.removesuffix("}").rstrip() + (", " if content else "")
    seal = hashlib.sha256(text.encode()).hexdigest()
    write_text(path, f'{text}"seal": "{seal}"}}\n')


def npz_bytes(arrays: Mapping[str, np.ndarray]) -> bytes:
    """Return ``arrays`` as a sealed ``.npz`` archive; the same arrays make the same bytes."""
    buffer = BytesIO()
    _save_sealed(buffer, arrays)
    return buffer.getvalue()


def write_npz(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Write `npz_bytes` of ``arrays`` to ``path``, as `replacing` does, without a copy of them."""
    with replacing(path) as stream:
        _save_sealed(stream, arrays)


def _save_sealed(stream: BinaryIO, arrays: Mapping[str, np.ndarray]) -> None:
    np.savez(stream, **arrays)  # type: ignore[arg-type]
    # The seal is the archive's comment, whose length its last two bytes say.
    stream.seek(-2, os.SEEK_END)
    stream.write(struct.pack("<H", len(SEAL_OF_ARCHIVE) + 64))
    stream.write(_seal_of(stream, stream.tell()))


def _seal_of(stream: BinaryIO, end: int) -> bytes:
    """Return the SHA-256 of the first ``end`` bytes, as text; then the stream is there."""
    digest = hashlib.sha256()
    stream.seek(0)
    while end > 0 and (part := stream.read(min(end, 1 << 20))):
        digest.update(part)
        end -= len(part)
    return SEAL_OF_ARCHIVE + digest.hexdigest().encode()


def can_create(path: Path) -> bool:
    """Return whether ``path`` can be made: whether the nearest folder that is there takes one.

    It is tried, since folders of the system that are no place for files give all rights to some.
    """
    nearest = next(parent for parent in path.absolute().parents if parent.exists())
    trial = temporary_name(nearest / path.name)
    try:
        os.mkdir(trial)
        os.rmdir(trial)
    except OSError:
        return False
    return True


def temporary_name(path: Path) -> Path:
    """Return a new name beside ``path`` of the form `TEMPORARY`."""
    return path.with_name(f".{path.name}.{uuid.uuid4().hex}")


def make_folder(folder: Path) -> None:
    """Make ``folder`` and those above it, where they are missing, to outlast a loss of power.

    Raises:
        FileExistsError: it is no folder.
    """
    if folder.is_dir():
        return
    make_folder(folder.parent)
    folder.mkdir(exist_ok=True)
    sync_folder(folder.parent)


def sync_folder(folder: Path) -> None:
    """Make the names in ``folder`` outlast a loss of power."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def read_bytes(path: Path, most: int = LARGEST) -> bytes:
    """Return the content of a file that somebody named, of at ``most`` so many bytes.

    Raises:
        OSError: it cannot be read, is larger, or is no file; see `refuse_endless`.
    """
    refuse_endless(path, most)
    with path.open("rb") as stream:
        # As much memory as is asked for is taken at once; pipes say no size.
        size = os.fstat(stream.fileno()).st_size or most
        content = stream.read(min(size, most) + 1)
    if len(content) > most:
        raise _too_large(path, "more", most)
    return content


def _too_large(path: Path, size: str, most: int) -> OSError:
    said = f"it has {size} bytes, allowed: up to {most:,}"
    return OSError(errno.EFBIG, said, str(path))


def refuse_endless(path: Path, most: int = LARGEST) -> None:
    """Raise the OSError of what may never end, or be larger than memory.

    Pipes that shells make pass, as for ``tactilux describe <(...)``: they are in ``/dev``. One that
    lies in a folder waits for ever for somebody to write to it.
    """
    about = os.stat(path)
    if stat.S_ISCHR(about.st_mode) or stat.S_ISBLK(about.st_mode):
        raise OSError(errno.EINVAL, "it is a device, no file", str(path))
    if stat.S_ISFIFO(about.st_mode) and path.parts[:2] not in (("/", "dev"), ("/", "proc")):
        raise OSError(errno.EINVAL, "it is a pipe, no file", str(path))
    if stat.S_ISREG(about.st_mode) and about.st_size > most:
        raise _too_large(path, f"{about.st_size:,}", most)


def read_text(path: Path, codecs: Sequence[str] = ("utf-8-sig",)) -> str:
    """Return the text of a file that a person wrote: UTF-16 with its mark, or the first that fits.

    Raises:
        ValueError: a phrase that says why there is none: no such file, a folder, too large, not of
            these ``codecs``.
    """
    try:
        content = read_bytes(path, MOST_TEXT)
    except OSError as error:
        raise ValueError(f"cannot be read: {error.strerror}") from error
    except ValueError:
        raise ValueError("cannot be read: no file can have this name") from None
    # Editors on Windows put a mark in front, and end lines in their own way.
    marked = content.startswith((BOM_UTF16_LE, BOM_UTF16_BE))
    for codec in ("utf-16",) if marked else codecs:
        with suppress(UnicodeDecodeError):
            return content.decode(codec).replace("\r\n", "\n").replace("\r", "\n")
    raise ValueError("is not text in UTF-8")


def parse_toml(text: str) -> dict[str, Any]:
    """Return the content of a TOML file.

    Raises:
        ValueError: what is wrong, and where.
    """
    with _told_in_words():
        content = tomllib.loads(text)
        _refuse_depth(content)
        return content


def parse_json(text: str) -> Any:
    """Return the content of a JSON file.

    Raises:
        ValueError: what is wrong, and where.
    """
    with _told_in_words():
        content = json.loads(text)
        _refuse_depth(content)
        return content


def _refuse_depth(content: Any) -> None:
    level: list[Any] = [[content]]
    for _ in range(MOST_DEPTH + 1):
        inner = [part.values() if isinstance(part, dict) else part for part in level]
        level = [one for parts in inner for one in parts if isinstance(one, dict | list)]
        if not level:
            return
    raise RecursionError


@contextmanager
def _told_in_words() -> Iterator[None]:
    """Say of depth and digits, which Python's own limits stop, what is wrong with the file."""
    try:
        yield
    except RecursionError:
        raise ValueError(
            f"its tables and lists lie more than {MOST_DEPTH} deep in each other"
        ) from None
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
        return read_sealed(path)
    except (OSError, ValueError):
        return {}


def read_sealed(path: Path) -> dict[str, Any]:
    """Return the object that `write_json` wrote to ``path``, without its seal.

    Raises:
        OSError: it cannot be read.
        ValueError: what is wrong with it; one without a seal is of an earlier version, and whole.
    """
    text = read_bytes(path)
    seal = SEAL.search(text)
    if seal is None:
        if SEALED.search(text[-200:]):
            raise ValueError("its seal is damaged")
    elif hashlib.sha256(text[: seal.start()]).hexdigest().encode() != seal[1]:
        raise ValueError("it is not as it was written")
    try:
        content = parse_json(text.decode("utf-8"))
    except json.JSONDecodeError:
        raise ValueError("it is not JSON" if text.strip() else "it is empty") from None
    if not isinstance(content, dict):
        raise ValueError("it holds no object")
    content.pop("seal", None)
    return content


def read_npz(path: Path, *, sealed: bool = False) -> dict[str, np.ndarray]:
    """Return all arrays of an ``.npz`` file; with ``sealed`` only of one with a seal.

    Raises:
        TableError: when the file is missing, damaged, or holds anything but plain arrays.
        ReadError: when it may well be whole, and memory, handles or rights do not suffice to read
            it.
    """
    try:
        refuse_endless(path)
        # Opened as a zip first: numpy would take other files for a pickle or a single array.
        with zipfile.ZipFile(path) as archive:
            foreign = [name for name in archive.namelist() if not name.endswith(".npy")]
            seal = archive.comment
            if foreign:
                raise TableError(f"{path} holds more than arrays: {foreign[0]!r}", field="table")
            unpacked = sum(member.file_size for member in archive.infolist())
            if unpacked > max(MOST_UNPACKED, MOST_SHRUNK * path.stat().st_size):
                raise TableError(
                    f"{path} would unpack to {unpacked / MEGABYTE:.0f} MB, allowed: up to "
                    f"{MOST_UNPACKED // MEGABYTE} MB, or {MOST_SHRUNK} times its size",
                    field="table",
                )
            if any(_promised(archive, member) > member.file_size for member in archive.infolist()):
                raise ValueError("more numbers than bytes")
        if seal or sealed:
            with path.open("rb") as stream:
                found = _seal_of(stream, path.stat().st_size - len(seal))
            if seal != found:
                why = "damaged: it is not as it was written" if seal else "of an earlier version"
                raise TableError(f"{path} is {why}", field="table")
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


def _promised(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> int:
    """Return how many bytes the array of a member has by its header, which numpy believes."""
    with archive.open(member) as stream:
        first = np.lib.format.read_magic(stream) == (1, 0)
        read = np.lib.format.read_array_header_1_0 if first else np.lib.format.read_array_header_2_0
        shape, _, dtype = read(stream)
    return math.prod(shape) * dtype.itemsize


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
