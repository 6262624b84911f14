"""Compilation of inner loops by numba, kept on disk between runs where that is possible."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., Any])

# Contraction and reciprocals may round differently; NaN and infinity keep their meaning.
_FASTMATH = {"contract", "arcp", "nsz"}


def compiled(function: F) -> F:
    """Compile ``function`` on its first call; it runs without the interpreter's lock.

    The machine code is stored beside the source, else in the user's cache folder; in an install
    where neither can be written it is compiled anew in every process.
    """
    options: dict[str, Any] = {"nogil": True, "error_model": "numpy", "fastmath": _FASTMATH}
    try:
        return cast(F, numba.njit(cache=True, **options)(function))
    except RuntimeError:  # numba found no folder that it may write to
        return cast(F, numba.njit(**options)(function))
