"""Functions that numba compiles, and where their machine code is kept."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., Any])


def compiled(function: F, **options: Any) -> F:
    """Compile ``function`` on its first call; it runs without the interpreter's lock.

    The machine code is stored beside the source, else in the user's cache folder; in an install
    where neither can be written it is compiled anew in every process. numba's store notices when a
    function's own file changes, not when a function of another file does that it calls: what is
    compiled together lives in one file.
    """
    try:
        return cast(F, numba.njit(cache=True, nogil=True, **options)(function))
    except RuntimeError:  # numba found no folder that it may write to
        return cast(F, numba.njit(nogil=True, **options)(function))
