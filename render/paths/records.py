"""Records of vertices in memory, where other lanes read them: written, stacked and packed.

A record is a dataclass of arrays, Mitsuba's structures and records (a Dr.Jit PyTree).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import is_dataclass
from itertools import count
from typing import Any

import drjit as dr
import mitsuba as mi


def allocated(record: Any, size: int) -> Any:
    """Return uninitialized arrays of ``size``, shaped like ``record``.

    ``dr.empty`` of a dataclass keeps the array types of the variant that was set first.
    """
    return _rebuilt(record, lambda kind: dr.empty(kind, size))


def stacked(records: list[Any], lanes: int) -> Any:
    """Return evaluated records of ``lanes`` entries each, one after the other."""
    leaves = zip(*(_leaves(record) for record in records), strict=True)

    def leaf(_kind: Any) -> Any:
        # What is the same in all lanes may be there only once.
        each = (x if dr.width(x) == lanes else dr.repeat(x, lanes) for x in next(leaves))
        return dr.concat(list(each))

    return _rebuilt(records[0], leaf)


class PackedRecords:
    """Records as rows of 32-bit words, which a dozen loads fetch instead of forty."""

    def __init__(self, records: Any) -> None:
        """Write the rows: all flags in the first word, every other number in one of its own."""
        self.records = records
        leaves, flags = _leaves(records), mi.UInt32(0)
        for k, flag in enumerate(x for x in leaves if type(x) is mi.Bool):
            flags |= dr.select(flag, mi.UInt32(1 << k), 0)
        numbers = [x for x in leaves if type(x) is not mi.Bool]
        words = [flags, *(dr.reinterpret_array(mi.UInt32, x) for x in numbers)]
        words += [mi.UInt32(0)] * (-len(words) % 4)
        self.loads, width = len(words) // 4, dr.width(flags)
        self.rows = dr.empty(mi.UInt32, len(words) * width)
        row = self.loads * dr.arange(mi.UInt32, width)
        for i in range(self.loads):
            dr.scatter(self.rows, mi.Vector4u(*words[4 * i : 4 * i + 4]), row + i)
        dr.eval(self.rows)

    def gather(self, index: mi.UInt32, active: mi.Bool | bool = True) -> Any:
        """Return the records at ``index``."""
        row = self.loads * index
        fetched = (dr.gather(mi.Vector4u, self.rows, row + i, active) for i in range(self.loads))
        flags, *words = (word for load in fetched for word in load)
        numbers, bits = iter(words), count()

        def leaf(kind: Any) -> Any:
            if kind is mi.Bool:
                return (flags & (1 << next(bits))) != 0
            return dr.reinterpret_array(kind, next(numbers))

        return _rebuilt(self.records, leaf)


def _parts(tree: Any) -> list[tuple[Any, Any]] | None:
    """Return the names and parts of a dataclass, Mitsuba structure or vector; None of a leaf."""
    if is_dataclass(tree):
        return list(vars(tree).items())
    if hasattr(type(tree), "DRJIT_STRUCT"):
        return [(name, getattr(tree, name)) for name in type(tree).DRJIT_STRUCT]
    return list(enumerate(tree)) if dr.depth_v(tree) > 1 else None


def _leaves(tree: Any) -> list[Any]:
    """Return the arrays of a tree, in order."""
    parts = _parts(tree)
    return [tree] if parts is None else [x for _, part in parts for x in _leaves(part)]


def _rebuilt(tree: Any, leaf: Callable[[Any], Any]) -> Any:
    """Return a tree like ``tree`` whose arrays of a kind are what ``leaf`` returns, in order."""
    parts, kind = _parts(tree), type(tree)
    if parts is None:
        return leaf(kind)
    built = [(name, _rebuilt(part, leaf)) for name, part in parts]
    if is_dataclass(tree):
        return kind(**dict(built))
    if hasattr(kind, "DRJIT_STRUCT"):
        whole = kind()
        for name, part in built:
            setattr(whole, name, part)
        return whole
    return kind(*(part for _, part in built))
