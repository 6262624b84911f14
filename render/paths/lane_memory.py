"""Records that lanes write inside a traced loop and read after it.

Global memory with one record per lane and slot. Dr.Jit's own local memory (1.5) does not compile
masks on LLVM. Records must be written under a mask argument, outside of a traced ``if``.
"""

from __future__ import annotations

from dataclasses import is_dataclass
from typing import Any

import drjit as dr
import mitsuba as mi


class LaneMemory:
    """``slots`` records per lane, shaped like the dataclass tree ``example``."""

    def __init__(self, example: Any, lanes: int, slots: int) -> None:
        """Allocate, uninitialized."""
        self.lanes = lanes
        self.lane: Any = dr.arange(mi.UInt32, lanes)
        self.records = _room(example, lanes * slots)

    def index(self, slot: Any, lane: Any) -> Any:
        """Return where the records of ``lane`` in ``slot`` are."""
        return slot * self.lanes + lane

    def write(self, slot: Any, record: Any, active: Any) -> None:
        """Store ``record`` in each active lane's ``slot``."""
        dr.scatter(self.records, record, self.index(slot, self.lane), active)

    def read(self, slot: Any, lane: Any) -> Any:
        """Return the records of ``lane`` in ``slot``."""
        return taken(self.records, self.index(slot, lane))


def _room(tree: Any, size: int) -> Any:
    kind: Any = type(tree)
    if is_dataclass(tree):
        return kind(**{name: _room(value, size) for name, value in vars(tree).items()})
    return dr.empty(kind, size)


def taken(tree: Any, index: Any, active: Any = True) -> Any:
    """Return the entries ``index`` of every array of a dataclass tree."""
    kind: Any = type(tree)
    if is_dataclass(tree):
        return kind(**{name: taken(value, index, active) for name, value in vars(tree).items()})
    return dr.gather(kind, tree, index, active)


def stacked(trees: list[Any], lanes: int) -> Any:
    """Return evaluated dataclass trees of ``lanes`` entries each, one after the other."""
    kind: Any = type(trees[0])
    if is_dataclass(trees[0]):
        return kind(**{k: stacked([getattr(t, k) for t in trees], lanes) for k in vars(trees[0])})
    if hasattr(kind, "DRJIT_STRUCT"):
        whole = kind()
        for name in kind.DRJIT_STRUCT:
            setattr(whole, name, stacked([getattr(t, name) for t in trees], lanes))
        return whole
    if dr.depth_v(kind) > 1:
        return kind(*(stacked(list(parts), lanes) for parts in zip(*trees, strict=True)))
    # What is the same in all lanes may be there only once.
    return dr.concat([t if dr.width(t) == lanes else dr.repeat(t, lanes) for t in trees])
