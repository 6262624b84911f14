"""What the public functions are given: checked at one place, and named where it is refused.

Each function here takes a value, the name of its argument and the error to raise, and returns what
the program works on. Ranges and shapes are checked where they are known.
"""

from __future__ import annotations

import math
import os
from pathlib import Path
from types import UnionType
from typing import Any, NoReturn

import numpy as np

from render.arrays import Array
from render.errors import TactiluxError
from render.refused_values import in_json

Refusal = type[TactiluxError]


def refuse(value: object, name: str, allowed: str, error: Refusal) -> NoReturn:
    """Raise ``error``: what the argument ``name`` is, and what it may be."""
    raise error(f"{name} = {shown(value)}, allowed: {allowed}", field=name)


def shown(value: object) -> str:
    """Return a value in few words.

    >>> shown("mini.toml"), shown(None), shown(np.zeros((2, 3))), shown(["red"])
    ('"mini.toml"', 'None', 'an array of shape (2, 3)', '["red"]')
    """
    if value is None or isinstance(value, bool | complex | bytes):
        return repr(value)
    if isinstance(value, np.ndarray):
        return f"an array of shape {value.shape}"
    if isinstance(value, str | int | float | list | tuple | dict):
        return in_json(value)
    if isinstance(value, os.PathLike):
        return in_json(os.fspath(value))
    kind = type(value).__name__
    return f"{'an' if kind[0] in 'AEIOaeio' else 'a'} {kind}"


def as_kind(value: Any, kind: type | UnionType, name: str, allowed: str, error: Refusal) -> Any:
    """Return a value that is of ``kind``, which ``allowed`` names."""
    if not isinstance(value, kind):
        refuse(value, name, allowed, error)
    return value


def as_one_of(value: object, known: tuple[object, ...], name: str, error: Refusal) -> None:
    """Refuse what is none of the ``known`` values."""
    if not any(value is one or (type(value) is type(one) and value == one) for one in known):
        refuse(value, name, ", ".join(map(str, known)), error)


def as_path(value: object, name: str, error: Refusal) -> Path:
    """Return the path that a text or a path names."""
    if isinstance(value, str | os.PathLike):
        path = os.fspath(value)
        if isinstance(path, str) and path and "\0" not in path:
            return Path(path)
    refuse(value, name, "a path", error)


def as_target(value: object, name: str, error: Refusal) -> Path:
    """Return the path of a file to write, which is no folder."""
    path = as_path(value, name, error)
    if path.is_dir():
        refuse(value, name, "a file to write, not a folder", error)
    return path


def as_folder(value: object, name: str, error: Refusal) -> Path | None:
    """Return the folder that a path names, whether it is there or not; None for None."""
    if value is None:
        return None
    folder = as_path(value, name, error)
    if folder.exists() and not folder.is_dir():
        refuse(value, name, "a folder, not a file", error)
    return folder


def as_numbers(value: object, name: str, error: Refusal) -> Array:
    """Return real numbers of any shape as an array, float64."""
    try:
        found = np.asarray(value)
    except (ValueError, TypeError):  # rows of different lengths
        refuse(value, name, "an array of real numbers", error)
    if found.dtype.kind not in "fiu":
        refuse(value, name, "an array of real numbers", error)
    return np.asarray(found, dtype=np.float64)


def as_whole(value: Any, name: str, error: Refusal, *, least: int) -> int:
    """Return a whole number of at least ``least``."""
    whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not whole or int(value) < least:
        refuse(value, name, f"a whole number of at least {least}", error)
    return int(value)


def as_seeds(value: object, error: Refusal) -> tuple[int, ...]:
    """Return distinct whole numbers, at least one."""
    seeds: Any = value.tolist() if isinstance(value, np.ndarray) else value
    if not isinstance(seeds, list | tuple | range) or not seeds:
        refuse(value, "seeds", "a list of distinct seeds, whole numbers of at least 0", error)
    found = tuple(as_whole(seed, "seeds", error, least=0) for seed in seeds)
    if len(set(found)) < len(found):
        refuse(value, "seeds", "distinct seeds, whole numbers of at least 0", error)
    return found


def as_number(value: Any, name: str, error: Refusal, *, least: float) -> float:
    """Return a finite number of at least ``least``."""
    plain = isinstance(value, float | int | np.integer | np.floating)
    if not plain or isinstance(value, bool) or not least <= float(value) < math.inf:
        refuse(value, name, f"a finite number of at least {least:g}", error)
    return float(value)


def as_callback(value: Any, name: str, error: Refusal) -> Any:
    """Return a function, or None."""
    if value is not None and not callable(value):
        refuse(value, name, "a function or None", error)
    return value
