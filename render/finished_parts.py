"""What long work has found so far, so that what is ended at any instant goes on from there.

A fit is made of parts: the preview's grid, every ridge, every training of networks, every
evaluation; traced light of what each lamp sends and each facet gets. Each is kept in a file of its
own when it is done, sums and networks in training every few seconds besides. What is asked for
again passes through the finished parts within moments and ends bit-equal.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from render.files import read_or_drop, write_npz

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    Value = TypeVar("Value", bound=DataclassInstance)


class FinishedParts:
    """Parts of the work of one ``key``, in a folder.

    Example:
        >>> FinishedParts(None, "").arrays("sum", lambda: {"sum": np.array(3)})
        {'sum': array(3)}

    ``folder`` None keeps nothing; ``key`` is a hash of all that the work depends on.
    """

    def __init__(self, folder: Path | None, key: str) -> None:
        self.folder, self.key = folder, key

    def inside(self, name: str) -> FinishedParts:
        """Return those of a piece of the work, in a folder of its own."""
        return type(self)(None if self.folder is None else self.folder / name, self.key)

    def load(self, name: str) -> dict[str, np.ndarray] | None:
        """Return what was kept as ``name``, None where that is nothing or of other work."""
        if self.folder is None:
            return None
        arrays = read_or_drop(self.folder / f"{name}.npz", "key")
        return arrays if arrays is not None and str(arrays.pop("key")) == self.key else None

    def save(self, name: str, arrays: Mapping[str, np.ndarray]) -> None:
        """Keep ``arrays`` as ``name``, in the place of what was kept before."""
        if self.folder is not None:
            write_npz(self.folder / f"{name}.npz", {**arrays, "key": np.array(self.key)})

    def arrays(self, name: str, make: Callable[[], dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
        """Return the arrays kept as ``name``, or make and keep them."""
        kept = self.load(name)
        if kept is None:
            kept = make()
            self.save(name, kept)
        return kept

    def value(self, name: str, kind: type[Value], make: Callable[[], Value]) -> Value:
        """Return the dataclass of numbers and words kept as ``name``, or make and keep it."""
        kept = self.arrays(name, lambda: {"value": np.array(json.dumps(asdict(make())))})
        return kind(**json.loads(str(kept["value"])))


NOTHING_KEPT = FinishedParts(None, "")
"""Of work that begins anew whenever it is asked for."""
