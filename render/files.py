"""Arrays on disk: ``.npz`` files written atomically and read without ever unpickling."""

from __future__ import annotations

import os
import uuid
import zipfile
import zlib
from pathlib import Path

import numpy as np

from render.errors import TableError


def write_npz(path: Path, arrays: dict[str, np.ndarray]) -> None:
    """Write arrays to ``path`` atomically: a temporary file in the same folder, then a rename."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{uuid.uuid4().hex}")
    try:
        with temporary.open("xb") as stream:
            np.savez(stream, **arrays)  # type: ignore[arg-type]
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(temporary, path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def read_npz(path: Path) -> dict[str, np.ndarray]:
    """Return all arrays of an ``.npz`` file.

    Raises:
        TableError: when the file is missing, damaged, or holds anything but plain arrays.
    """
    try:
        # Opened as a zip first: numpy would take other files for a pickle or a single array.
        with zipfile.ZipFile(path) as archive:
            foreign = [name for name in archive.namelist() if not name.endswith(".npy")]
        if foreign:
            raise TableError(f"{path} holds more than arrays: {foreign[0]!r}", field="table")
        with np.load(path, allow_pickle=False) as stored:
            return {name: np.asarray(stored[name]) for name in stored.files}
    except FileNotFoundError:
        raise TableError(f"{path} does not exist", field="table", value=str(path)) from None
    # What damaged or forged archives raise, from an unknown compression to an absurd shape.
    except (
        OSError,
        ValueError,
        EOFError,
        KeyError,
        MemoryError,
        RuntimeError,
        SyntaxError,
        OverflowError,
        zipfile.BadZipFile,
        zlib.error,
    ) as error:
        raise TableError(
            f"{path} is not a readable .npz file: {error}", field="table", value=str(path)
        ) from None


def read_or_drop(path: Path, *names: str) -> dict[str, np.ndarray] | None:
    """Return the arrays of a file that an earlier call kept, None without one.

    A file that is damaged, or lacks one of ``names``, is taken away, so that it is made again.
    """
    if not path.exists():
        return None
    try:
        arrays = read_npz(path)
    except TableError:
        arrays = {}
    if arrays and arrays.keys() >= set(names):
        return arrays
    path.unlink()
    return None
