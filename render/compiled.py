"""Functions that numba compiles, and where their machine code is kept."""

from __future__ import annotations

import hashlib
import inspect
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., Any])


def compiled(function: F, **options: Any) -> F:
    """Compile ``function`` on its first call; it runs without the interpreter's lock.

    The machine code is stored beside the source, else in the user's cache folder; in an install
    where neither can be written it is compiled anew in every process. numba's store notices when a
    function's own file changes, but not when that of a function, constant or record changes that
    it is compiled with: here it is told of every file in the folder. So what is compiled together
    lives in one folder.
    """
    try:
        dispatcher = numba.njit(cache=True, nogil=True, **options)(function)
        stored = dispatcher._cache._cache_file
        stamp = stored._source_stamp, _sources(Path(inspect.getfile(function)).parent)
        stored._source_stamp = stamp
    except (RuntimeError, AttributeError):
        # numba found no folder that it may write to, or is one whose store, to which no public way
        # leads, is made otherwise.
        return cast(F, numba.njit(nogil=True, **options)(function))
    return cast(F, dispatcher)


@cache
def _sources(folder: Path) -> bytes:
    """Return a digest of all Python files in a folder."""
    digest = hashlib.sha256()
    for file in sorted(folder.glob("*.py")):
        digest.update(hashlib.sha256(file.name.encode()).digest())
        digest.update(hashlib.sha256(file.read_bytes()).digest())
    return digest.digest()


def inlined(function: F) -> F:
    """Compile ``function`` into whatever calls it, as `compiled` does else."""
    return compiled(function, forceinline=True)
